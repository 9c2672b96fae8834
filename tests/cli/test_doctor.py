"""`adamanip doctor`: its verdict follows the machine, and every failure says what to do."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata

import pytest

from lerobot_adamanip.cli import doctor as checks
from lerobot_adamanip.cli.doctor import CheckResult, DoctorCommand
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_env_adamanip.sim import render_device

NO_VULKAN = {"VK_ICD_FILENAMES": "/nonexistent.json", "VK_DRIVER_FILES": "/nonexistent.json"}


def doctor_json(extra: dict[str, str]) -> tuple[int, dict[str, dict[str, object]], bool]:
    command = [sys.executable, "-m", "lerobot_adamanip.cli.main", "doctor", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | extra)
    report = json.loads(done.stdout)
    assert set(report) == {"checks", "ok"}
    return done.returncode, {row["name"]: row for row in report["checks"]}, report["ok"]


@pytest.mark.nightly
@pytest.mark.sim
def test_a_machine_that_was_set_up_passes() -> None:
    status, rows, ok = doctor_json({})
    assert {name for name, row in rows.items() if row["required"] and not row["ok"]} == set()
    assert (status, ok) == (0, True)


@pytest.mark.nightly
def test_without_a_vulkan_driver_clouds_are_possible_and_pictures_are_not() -> None:
    status, rows, ok = doctor_json(NO_VULKAN)
    assert (status, ok) == (0, True)
    assert rows["Ray-cast clouds"]["ok"]
    rendering = rows["SAPIEN renders"]
    assert not rendering["ok"]
    assert "collect --no-images" in str(rendering["advice"])
    assert "mesa-vulkan-drivers" in str(rendering["advice"])
    assert "VK_ICD_FILENAMES=/nonexistent.json" in str(rendering["advice"])


def test_every_environment_is_looked_for() -> None:
    (env, policy) = [check for check in checks.check_plugin() if check.name.startswith("LeRobot --")]
    assert env.ok
    assert policy.ok
    assert all(f"adamanip_{name}" in env.found for name in CATEGORIES)


@pytest.mark.parametrize(
    ("device", "has_gpu", "found"),
    [("cuda", True, "auto is cuda"), ("cpu", True, "auto is cpu"), ("none", False, "none: ")],
)
def test_the_render_backend_is_the_probes_answer(
    monkeypatch: pytest.MonkeyPatch, device: str, has_gpu: bool, found: str
) -> None:
    monkeypatch.setattr(render_device, "_has_gpu", lambda: has_gpu)
    monkeypatch.setattr(render_device, "rendering_device", lambda: device)
    check = checks.check_render_backend()
    assert check.found.startswith(found)
    assert check.ok == (device != "none")


def test_only_required_checks_decide_and_one_that_breaks_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def check_broken() -> Iterator[CheckResult]:
        yield CheckResult("first", True, "fine")
        raise ValueError("odd machine")

    wish = CheckResult("wish", False, "no [x]", "get one", required=False)
    monkeypatch.setattr(checks, "CHECKS", (lambda: wish,))
    assert DoctorCommand().run() == 0
    printed = capsys.readouterr().out
    assert "get one" in printed
    assert "no [x]" in printed
    monkeypatch.setattr(checks, "CHECKS", (lambda: wish, check_broken))
    assert DoctorCommand().run() == 1
    _, first, broken = checks.run_checks()
    assert first.ok
    assert (broken.name, broken.ok, broken.found) == ("broken", False, "ValueError: odd machine")


def test_versions_out_of_range_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    real = metadata.version
    monkeypatch.setattr(metadata, "version", lambda name: "0.5.1" if name == "lerobot" else real(name))
    found = {check.name: check for check in checks.check_versions()}
    assert not found["lerobot"].ok
    assert "0.5.1, wanted" in found["lerobot"].found
    assert found["torch"].ok
    monkeypatch.setattr(metadata, "version", lambda name: "2.4.1" if name == "numpy" else real(name))
    numpy = next(check for check in checks.check_versions() if check.name == "numpy")
    assert not numpy.ok  # LeRobot's own bound counts beside this package's


def test_a_probe_that_crashes_or_hangs_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    real = subprocess.run

    def instead(code: str) -> None:
        monkeypatch.setattr(subprocess, "run", lambda _cmd, **kw: real([sys.executable, "-c", code], **kw))

    instead("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    assert checks.run_probe("any") == (False, "crashed with signal 11")
    monkeypatch.setattr(checks, "PROBE_TIMEOUT_S", 0.2)
    instead("import time; time.sleep(30)")
    ok, answer = checks.run_probe("any")
    assert not ok
    assert "no answer" in answer
