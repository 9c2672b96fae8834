"""Workflows, templates and what else GitHub reads: valid, and what they name is there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
VERSION = re.compile(r"[\w.-]+/[\w.-]+@(v\d+\.\d+\.\d+|[0-9a-f]{40})")
TARGETS = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


def read(path: Path) -> dict[Any, Any]:
    found = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert isinstance(found, dict)
    return found


def steps(workflow: dict[Any, Any]) -> list[dict[str, Any]]:
    return [step for job in workflow["jobs"].values() for step in job["steps"]]


def commands(workflow: dict[Any, Any]) -> str:
    return "\n".join(step["run"] for step in steps(workflow) if "run" in step)


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda p: p.name)
def test_a_workflow_is_whole_pinned_and_without_rights(path: Path) -> None:
    workflow, text = read(path), path.read_text(encoding="utf-8")
    assert workflow["name"] == path.stem
    assert workflow[True]  # YAML reads the key `on` as a boolean, GitHub does not
    assert workflow["permissions"] == {"contents": "read"}
    jobs = workflow["jobs"]
    for name, job in jobs.items():
        assert job.get("needs", name) in jobs, name
        assert job["runs-on"]
        assert all(("run" in step) != ("uses" in step) for step in job["steps"]), name
    assert all(VERSION.fullmatch(step["uses"]) for step in steps(workflow) if "uses" in step)
    assert "secrets." not in text
    assert "pull_request_target" not in text
    # What others choose (a branch's name, a title) is an environment variable, never part of a script.
    chosen = r"\$\{\{\s*github\.(head_ref|ref_name|event\.(issue|pull_request|comment|head_commit))"
    assert not re.search(chosen, commands(workflow))


def test_what_workflows_run_is_there() -> None:
    text = "\n".join(commands(read(path)) for path in WORKFLOWS)
    assert all(word in text for word in ("make docs", "make check", "scripts/smoke_test_release.py", ".ci/run"))
    assert {word for line in re.findall(r"\bmake ([a-z ]+)", text) for word in line.split()} <= TARGETS
    files = set(re.findall(r"(?<![\w./-])((?:scripts|tests|\.ci)/[\w./-]+|constraints\.txt|CHANGELOG\.md)", text))
    assert {name for name in files if not (ROOT / name).exists()} == set()


def test_only_jobs_that_publish_have_rights() -> None:
    """They may say who they are, and write the pages."""
    jobs = {f"{path.stem}.{name}": job for path in WORKFLOWS for name, job in read(path)["jobs"].items()}
    rights = {name: job["permissions"] for name, job in jobs.items() if "permissions" in job}
    pages = {"pages": "write", "id-token": "write"}
    assert rights == {"docs.publish": pages, "release.publish": {"id-token": "write"}}


def test_a_release_uploads_what_was_tried_and_by_tag_alone() -> None:
    release = read(ROOT / ".github" / "workflows" / "release.yml")
    jobs = release["jobs"]
    assert release[True]["push"] == {"tags": ["v*"]}
    publish, tried = jobs["publish"], jobs["smoke-test"]
    assert (publish["needs"], tried["needs"]) == ("smoke-test", "build")
    assert publish["if"] == "github.event_name == 'push' && github.ref_type == 'tag'", "not by hand, even on a tag"
    assert publish["environment"] == "pypi"
    assert not [step for step in publish["steps"] if "run" in step]  # it only takes what was tried
    names = {step["with"]["name"] for step in steps(release) if "artifact@" in step.get("uses", "")}
    assert names == {"dist"}
    assert '--tag "$TAG"' in commands(release)
    assert tried["strategy"]["matrix"]["extras"] == ["", "sim"]
