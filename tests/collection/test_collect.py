from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from demos_helpers import HERE, fakes, make_spec, patiently, same_bytes, same_content

from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.collection.replay import replay
from lerobot_adamanip.datasets.collection_spec import CollectionPaths
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.util.errors import DatasetError

here = pytest.mark.usefixtures("in_process")
Refuses = Callable[[type, Callable[[], Any]], str]

SCRIPT = """
import json, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from demos_helpers import fakes, make_spec, patiently
from lerobot_adamanip.collection.collect import collect
if __name__ == "__main__":
    asked = json.loads(sys.argv[3])
    collect(Path(sys.argv[2]), make_spec(**asked["spec"]), fakes(**asked["fakes"]), patiently(**asked["options"]))
"""


def start(
    tmp_path: Path, root: Path, behaviour: dict[str, Any], *, workers: int = 1, **spec: Any
) -> subprocess.Popen[bytes]:
    script = tmp_path / "collect_script.py"
    script.write_text(SCRIPT)
    asked = json.dumps({"spec": spec, "fakes": behaviour, "options": {"workers": workers}})
    return subprocess.Popen([sys.executable, str(script), HERE, str(root), asked], start_new_session=True)


def shards(root: Path) -> set[str]:
    return {path.name for path in CollectionPaths(root).episodes.glob("*.safetensors")}


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


def interrupting(stage: str, at: int) -> Callable[[str, int, int], None]:
    """A listener that interrupts the collection once ``at`` episodes of a stage are done."""

    def listen(now: str, done: int, total: int) -> None:
        if now == stage and done == at:
            raise KeyboardInterrupt

    return listen


def test_two_workers_of_which_one_crashes_record_what_one_does(tmp_path: Path, finished: Path) -> None:
    crashing = fakes(crash=f"once:{tmp_path / 'marker'}")
    summary = collect(tmp_path / "dataset", make_spec(), crashing, patiently(workers=2))
    assert (tmp_path / "marker").exists()
    assert summary.episodes == summary.recorded == 6
    assert summary.attempts == summary.attempted > 6  # the fake expert fails sometimes
    assert summary.success_rate == 6 / summary.attempted
    same_bytes(finished, tmp_path / "dataset")
    same_content(finished, tmp_path / "dataset")


def test_an_object_that_kills_its_workers_is_reported(tmp_path: Path, refuses: Refuses) -> None:
    spec = make_spec(episodes_per_object=1)
    message = refuses(DatasetError, lambda: collect(tmp_path / "dataset", spec, fakes(crash="safe_001"), patiently()))
    assert "safe_001, episode 0" in message
    assert "SIGKILL" in message


@pytest.mark.parametrize("whole_group", [True, False], ids=["group", "parent-only"])
def test_kill_9_loses_at_most_the_episode_in_progress(tmp_path: Path, finished: Path, whole_group: bool) -> None:
    """Of the parent alone, too: then its workers end by themselves."""
    root = tmp_path / "dataset"
    # The delay makes an episode last long enough to be killed in; it is no part of what is recorded.
    process = start(tmp_path, root, {"delay": 0.1}, workers=1 if whole_group else 2)
    wait_for(lambda: len(shards(root)) >= 2)
    before = shards(root)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    workers = [Path("/proc") / pid for pid in children.read_text().split()]
    assert workers
    (os.killpg if whole_group else os.kill)(process.pid, signal.SIGKILL)
    process.wait()
    wait_for(lambda: not any(worker.exists() for worker in workers), seconds=20.0)
    assert before <= shards(root)
    assert not root.exists()

    times = {name: (CollectionPaths(root).episodes / name).stat().st_mtime_ns for name in before}
    unchanged = []

    def listener(stage: str, done: int, total: int) -> None:
        if stage == "assemble" and done == 1:
            now = {name: (CollectionPaths(root).episodes / name).stat().st_mtime_ns for name in before}
            unchanged.append(now == times)

    summary = collect(root, make_spec(), fakes(), patiently(), listener)
    assert unchanged == [True]  # what was recorded before the kill was not recorded again
    assert summary.recorded <= 6 - len(before)
    same_bytes(finished, root)
    assert not CollectionPaths(root).partial.exists()


@here
def test_a_damaged_episode_file_is_recorded_again(tmp_path: Path, finished: Path) -> None:
    root = tmp_path / "dataset"
    with pytest.raises(KeyboardInterrupt):
        collect(root, make_spec(), fakes(), patiently(), interrupting("assemble", 1))
    victim = CollectionPaths(root).episodes / make_spec().items()[2].file_name
    victim.write_bytes(victim.read_bytes()[:-100])
    assert collect(root, make_spec(), fakes(), patiently()).recorded == 1
    same_bytes(finished, root)


@here
def test_a_complete_dataset_is_left_alone(finished: Path, refuses: Refuses) -> None:
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    summary = collect(finished, make_spec(), fakes())
    assert summary.recorded == 0
    assert summary.attempted > summary.episodes == 6
    assert before == {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    message = refuses(DatasetError, lambda: collect(finished, make_spec(episodes_per_object=4), fakes()))
    assert "episodes_per_object = 4" in message


@here
def test_other_options_do_not_continue_a_collection(tmp_path: Path, refuses: Refuses) -> None:
    root = tmp_path / "dataset"
    with pytest.raises(KeyboardInterrupt):
        collect(root, make_spec(), fakes(), patiently(), interrupting("record", 1))
    message = refuses(DatasetError, lambda: collect(root, make_spec(expert="static"), fakes()))
    assert "expert = 'static'" in message
    assert "expert = 'adaptive'" in message
    message = refuses(DatasetError, lambda: collect(root, make_spec(), fakes(code="b")))
    assert "other versions: code differ" in message


@here
def test_a_collection_that_never_recorded_anything_binds_nobody(tmp_path: Path, refuses: Refuses) -> None:
    root = tmp_path / "dataset"
    hopeless = fakes(hopeless="safe_000", code="b")
    refuses(DatasetError, lambda: collect(root, make_spec(objects=("safe_000",)), hopeless, patiently(max_attempts=1)))
    assert collect(root, make_spec(), fakes(), patiently()).episodes == 6


@here
def test_what_cannot_be_recorded_is_reported_counted_and_left_out_only_on_request(
    tmp_path: Path, refuses: Refuses
) -> None:
    root, hopeless = tmp_path / "dataset", fakes(hopeless="safe_001")
    spec = make_spec(episodes_per_object=2)
    message = refuses(DatasetError, lambda: collect(root, spec, hopeless, patiently()))
    assert "safe_001, episode 0" in message
    assert "unreachable" in message
    assert not root.exists()
    summary = collect(root, spec, hopeless, patiently(max_attempts=2, allow_missing=True))
    assert summary.episodes == 2
    assert len(summary.failures) == summary.given_up == 2
    listed = [json.loads(line) for line in (root / "meta" / "attempts.jsonl").read_text().splitlines()]
    assert summary.attempted == len(listed)
    assert sum(attempt["object_id"] == "safe_001" for attempt in listed) == 4  # two items, two attempts each
    assert sum(attempt["kept"] for attempt in listed) == 2
    counts = json.loads((root / "meta" / "collection.json").read_text())["attempts"]
    assert counts == {"attempted": len(listed), "given_up": 2, "kept": 2}
    assert f"{len(listed)} episodes were attempted" in (root / "README.md").read_text()
    assert summary.categories["safe"].attempts == len(listed)
    message = refuses(DatasetError, lambda: collect(root, spec, hopeless, patiently(max_attempts=2)))
    assert "2 episodes were given up" in message


def test_a_retry_meets_the_hidden_state_of_the_attempt_before_it(tmp_path: Path, finished: Path) -> None:
    """Otherwise what is hard is thinned out, and successes alone would mislead."""
    items: dict[tuple[str, int], list[bool]] = {}
    for line in (finished / "meta" / "attempts.jsonl").read_text().splitlines():
        attempt = json.loads(line)
        if attempt["hidden_state"] is not None:
            items.setdefault((attempt["object_id"], attempt["slot"]), []).append(attempt["hidden_state"]["locked"])
    assert len(items) == 6
    assert any(len(drawn) > 1 for drawn in items.values())
    assert all(len(set(drawn)) == 1 for drawn in items.values())
    assert {drawn[0] for drawn in items.values()} == {True, False}
    for row in Dataset(finished).table.to_pylist():
        assert json.loads(row["hidden_state"])["locked"] == items[row["object_id"], row["slot"]][0]


@here
def test_failed_episodes_are_kept_apart_if_asked_for(tmp_path: Path, finished: Path) -> None:
    root, failed = tmp_path / "dataset", tmp_path / "dataset-failed"
    collect(root, make_spec(keep_failed=True), fakes(), patiently())
    rows, kept = Dataset(failed).table.to_pylist(), Dataset(root).table.to_pylist()
    assert not any(row["success"] for row in rows)
    assert [row["seed"] for row in kept] == [row["seed"] for row in Dataset(finished).table.to_pylist()]
    attempts = [json.loads(line) for line in (root / "meta" / "attempts.jsonl").read_text().splitlines()]
    lost = [attempt for attempt in attempts if not attempt["kept"]]
    started = {attempt["seed"] for attempt in lost if not str(attempt["reason"]).startswith("unreachable")}
    assert {row["seed"] for row in rows} == started
    # A failed episode stands for itself; a kept one carries all attempts before it.
    assert any(row["attempt"] for row in rows)
    assert not any(json.loads(row["failures"]) for row in rows)
    assert all(len(json.loads(row["failures"])) == row["attempt"] for row in kept)
    assert Dataset(failed).features == Dataset(root).features
    assert "failed episodes" in (failed / "README.md").read_text()
    for row in rows[:3]:
        assert replay(failed, row["episode_index"], fakes().environment).agrees(0.0)


def test_an_environment_that_cannot_be_built_ends_the_collection_with_its_reason(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="no simulator here"):
        collect(tmp_path / "dataset", make_spec(), fakes(broken=True))
    assert list(tmp_path.iterdir()) == []


@here
def test_the_expert_decides_the_data_but_not_the_episodes(tmp_path: Path, finished: Path) -> None:
    collect(tmp_path / "dataset", make_spec(expert="static"), fakes(), patiently())
    adaptive, static = (Dataset(root).table.to_pylist() for root in (finished, tmp_path / "dataset"))
    assert [row["seed"] for row in adaptive] == [row["seed"] for row in static]
    assert [row["start"] for row in adaptive] == [row["start"] for row in static]
    assert all(row["failed_tries"] == 0 for row in static)
    assert any(row["failed_tries"] == 1 for row in adaptive)


@here
def test_all_categories_make_one_dataset_of_what_each_gives_alone(tmp_path: Path) -> None:
    told: dict[str, list[int]] = {}
    everything = make_spec(objects=("safe_000", "safe_001", "lamp_000"), episodes_per_object=2)
    summary = collect(
        tmp_path / "all",
        everything,
        fakes(),
        patiently(workers=2),
        lambda stage, done, total: told.setdefault(stage, []).append(done),
    )
    assert {name: row.episodes for name, row in summary.categories.items()} == {"safe": 4, "lamp": 2}
    assert told["record safe"] == sorted(told["record safe"])
    assert (told["record safe"][-1], told["record lamp"][-1], told["record"][-1]) == (4, 2, 6)
    only = make_spec(category="lamp", objects=("lamp_000",), episodes_per_object=2)
    alone = collect(tmp_path / "lamp", only, fakes(), patiently())
    assert alone.categories["lamp"].attempts == summary.categories["lamp"].attempts
    rows = [row for row in Dataset(tmp_path / "all").table.to_pylist() if row["object_id"] == "lamp_000"]
    for row, other in zip(rows, Dataset(tmp_path / "lamp").table.to_pylist(), strict=True):
        assert {key: row[key] for key in ("seed", "length", "hidden_state")} == {
            key: other[key] for key in ("seed", "length", "hidden_state")
        }
