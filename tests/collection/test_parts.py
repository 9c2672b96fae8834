"""Parts of a collection, recorded apart and put together: the bytes of one collection."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from demos_helpers import NoWorkers, fakes, make_spec, patiently, same_bytes

from lerobot_adamanip.cli.main import main, parse_command
from lerobot_adamanip.collection import record
from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.collection.partial import Part
from lerobot_adamanip.datasets.collection_spec import CollectionPaths
from lerobot_adamanip.datasets.manifest import read_manifest
from lerobot_adamanip.util import jobs
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

Refuses = Callable[[type, Callable[[], Any]], str]


pytestmark = pytest.mark.usefixtures("in_process")


def record_parts(folder: Path, **changes: Any) -> tuple[Path, ...]:
    """Records a collection in two parts; returns their roots."""
    roots = (folder / "first", folder / "second")
    for number, root in enumerate(roots, 1):
        options = patiently(part=Part(number, 2), allow_missing=True, **changes.get("options", {}))
        summary = collect(root, make_spec(**changes.get("spec", {})), fakes(**changes.get("fakes", {})), options)
        assert not root.exists()
        assert summary.episodes + summary.given_up == 3
    return roots


def test_two_parts_adopted_are_one_collection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Failed episodes and given-up items included; and no simulator is needed where they are put together."""
    same = {"keep_failed": True}
    behaviour = {"hopeless": "safe_001"}
    whole = tmp_path / "whole" / "dataset"
    collect(whole, make_spec(**same), fakes(**behaviour), patiently(allow_missing=True))
    parts = record_parts(tmp_path, spec=same, fakes=behaviour)
    monkeypatch.setattr(jobs, "WorkerPool", NoWorkers)
    options = patiently(adopt=parts, allow_missing=True)
    summary = collect(tmp_path / "adopted" / "dataset", make_spec(**same), fakes(**behaviour), options)
    assert (summary.episodes, summary.given_up) == (3, 3)
    same_bytes(whole.parent, tmp_path / "adopted")


def test_processors_are_recorded_and_a_mixture_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    parts = tmp_path / "first", tmp_path / "second"
    for number, root in enumerate(parts, 1):
        monkeypatch.setattr(record, "cpu_model", lambda number=number: f"Processor {number}")
        collect(root, make_spec(), fakes(), patiently(part=Part(number, 2)))
    collect(tmp_path / "dataset", make_spec(), fakes(), patiently(adopt=parts))
    (message,) = caplog.messages
    assert "Recorded on different processors (Processor 1, Processor 2)" in message
    manifest = read_manifest(CollectionPaths(tmp_path / "dataset").manifest)
    assert manifest.processors == ("Processor 1", "Processor 2")
    caplog.clear()
    collect(tmp_path / "alone", make_spec(), fakes(), patiently())
    assert caplog.messages == []
    assert read_manifest(CollectionPaths(tmp_path / "alone").manifest).processors == ("Processor 2",)


def test_what_parts_lack_is_recorded_on_adoption(tmp_path: Path, finished: Path) -> None:
    first, _ = record_parts(tmp_path)
    summary = collect(tmp_path / "dataset", make_spec(), fakes(), patiently(adopt=(first,)))
    assert summary.recorded == 3
    same_bytes(finished, tmp_path / "dataset")


def test_a_part_resumes_and_becomes_the_whole_without_the_option(tmp_path: Path, finished: Path) -> None:
    root = tmp_path / "dataset"
    part = patiently(part=Part(1, 2))
    assert collect(root, make_spec(), fakes(), part).recorded == 3
    assert collect(root, make_spec(), fakes(), part).recorded == 0
    assert collect(root, make_spec(), fakes(), patiently()).recorded == 3
    same_bytes(finished, root)


def test_only_parts_of_this_collection_are_adopted(tmp_path: Path, refuses: Refuses) -> None:
    first, second = record_parts(tmp_path)

    def adopting(*roots: Path, **changes: Any) -> Callable[[], Any]:
        spec, behaviour = make_spec(**changes.pop("spec", {})), fakes(**changes)
        return lambda: collect(tmp_path / "dataset", spec, behaviour, patiently(adopt=roots))

    assert "Nothing was recorded" in refuses(DatasetError, adopting(tmp_path / "nowhere"))
    assert "seed = 5" in refuses(DatasetError, adopting(first, spec={"seed": 5}))
    assert "other versions: code" in refuses(DatasetError, adopting(first, code="b"))
    episodes = CollectionPaths(second).episodes
    one, other = sorted(episodes.iterdir())[:2]
    one.write_bytes(other.read_bytes())  # an episode under another's name
    assert "not what its name says" in refuses(DatasetError, adopting(first, second))
    one.write_bytes(one.read_bytes()[:-9])
    assert "damaged" in refuses(DatasetError, adopting(first, second))


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "1/0", "a/b", "-1/2", "1/2/3", ""])
def test_impossible_parts_are_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match="K/N"):
        Part.parse(text)


def test_the_command_takes_a_part_or_adopts_parts(tmp_path: Path) -> None:
    line = ["collect", str(tmp_path / "dataset"), "--part", "1/2"]
    assert parse_command("collect", line[1:]).options().part == Part(1, 2)
    adopting = ["--adopt", str(tmp_path / "a"), str(tmp_path / "b")]
    assert parse_command("collect", [line[1], *adopting]).options().adopt == (tmp_path / "a", tmp_path / "b")
    assert main([*line, *adopting]) == 2
