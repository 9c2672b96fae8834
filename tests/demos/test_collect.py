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
from demos_helpers import ATTEMPTS, HERE, OPTIONS, same_content

from lerobot_adamanip.demos import collect as collecting
from lerobot_adamanip.demos.collect import collect
from lerobot_adamanip.demos.collection import CollectionPaths, CollectionSpec
from lerobot_adamanip.demos.loading import episode_table
from lerobot_adamanip.demos.pool import WorkerError
from lerobot_adamanip.errors import DatasetError

Options = Callable[..., CollectionSpec]
Refuses = Callable[[type, Callable[[], Any]], str]

SCRIPT = """
import json, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from lerobot_adamanip.demos.collect import collect
from lerobot_adamanip.demos.collection import CollectionSpec
if __name__ == "__main__":
    options = CollectionSpec.from_json(json.loads(sys.argv[3]))
    collect(Path(sys.argv[2]), options, workers=int(sys.argv[4]), max_attempts=int(sys.argv[5]))
"""


def start(tmp_path: Path, root: Path, options: CollectionSpec, workers: int) -> subprocess.Popen[bytes]:
    script = tmp_path / "collect_script.py"
    script.write_text(SCRIPT)
    arguments = [HERE, str(root), json.dumps(options.to_json()), str(workers), str(ATTEMPTS)]
    return subprocess.Popen([sys.executable, str(script), *arguments], start_new_session=True)


def shards(root: Path) -> set[str]:
    return {path.name for path in CollectionPaths(root).episodes.glob("*.safetensors")}


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


def test_two_workers_record_what_one_does(tmp_path: Path, options: Options, finished: Path) -> None:
    summary = collect(tmp_path / "dataset", options(), workers=2, max_attempts=ATTEMPTS)
    assert summary.episodes == summary.recorded == 6
    assert summary.attempts > 6  # the fake expert fails sometimes
    same_content(finished, tmp_path / "dataset")


@pytest.mark.parametrize("whole_group", [True, False], ids=["group", "parent-only"])
def test_kill_9_loses_at_most_the_episode_in_progress(
    tmp_path: Path, options: Options, finished: Path, whole_group: bool
) -> None:
    root = tmp_path / "dataset"
    # The delay makes an episode last long enough to be killed in; it is no part of what is recorded.
    slow = options(env_options={"delay": 0.1})
    process = start(tmp_path, root, slow, workers=1)
    wait_for(lambda: len(shards(root)) >= 2)
    before = shards(root)
    (os.killpg if whole_group else os.kill)(process.pid, signal.SIGKILL)
    process.wait()
    assert before <= shards(root)
    assert not root.exists()

    times = {name: (CollectionPaths(root).episodes / name).stat().st_mtime_ns for name in before}
    unchanged = []

    def listener(stage: str, done: int, total: int) -> None:
        if stage == "assemble" and done == 1:
            now = {name: (CollectionPaths(root).episodes / name).stat().st_mtime_ns for name in before}
            unchanged.append(now == times)

    summary = collect(root, slow, max_attempts=ATTEMPTS, listener=listener)
    assert unchanged == [True]  # what was recorded before the kill was not recorded again
    assert summary.recorded <= 6 - len(before)
    (root / "meta" / "collection.json").write_text((finished / "meta" / "collection.json").read_text())
    same_content(finished, root)
    assert not CollectionPaths(root).partial.exists()


def test_workers_end_when_their_parent_is_killed(tmp_path: Path, options: Options) -> None:
    root = tmp_path / "dataset"
    process = start(tmp_path, root, options(env_options={"delay": 0.3}, episodes_per_object=50), workers=2)
    wait_for(lambda: len(shards(root)) >= 1)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    workers = [Path("/proc") / pid for pid in children.read_text().split()]
    assert workers
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    wait_for(lambda: not any(worker.exists() for worker in workers), seconds=20.0)


def test_an_interrupted_assembly_starts_over(
    tmp_path: Path, options: Options, finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "dataset"

    def interrupt(stage: str, done: int, total: int) -> None:
        if stage == "assemble" and done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(root, options(), max_attempts=ATTEMPTS, listener=interrupt)
    assert not root.exists()
    monkeypatch.setattr(collecting, "WorkerPool", NoWorkers)
    collect(root, options(), max_attempts=ATTEMPTS)
    same_content(finished, root)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dataset"]


class NoWorkers:
    """Stands in for the pool where nothing may be left to record."""

    def __init__(self, *_: object) -> None: ...

    def __enter__(self) -> NoWorkers:
        return self

    def __exit__(self, *_: object) -> None: ...

    def run(self, items: list[object]) -> list[object]:
        assert items == []
        return []


def test_a_damaged_episode_file_is_recorded_again(tmp_path: Path, options: Options, finished: Path) -> None:
    root = tmp_path / "dataset"

    def interrupt(stage: str, done: int, total: int) -> None:
        if stage == "assemble":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(root, options(), max_attempts=ATTEMPTS, listener=interrupt)
    victim = CollectionPaths(root).episodes / options().items()[2].file_name
    victim.write_bytes(victim.read_bytes()[:-100])
    assert collect(root, options(), max_attempts=ATTEMPTS).recorded == 1
    same_content(finished, root)


def test_a_complete_dataset_is_left_alone(options: Options, finished: Path, refuses: Refuses) -> None:
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    assert collect(finished, options()).recorded == 0
    assert before == {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    message = refuses(DatasetError, lambda: collect(finished, options(episodes_per_object=4)))
    assert "episodes_per_object = 4" in message


def test_other_options_do_not_continue_a_collection(tmp_path: Path, options: Options, refuses: Refuses) -> None:
    def interrupt(stage: str, done: int, total: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    root = tmp_path / "dataset"
    with pytest.raises(KeyboardInterrupt):
        collect(root, options(), max_attempts=ATTEMPTS, listener=interrupt)
    message = refuses(DatasetError, lambda: collect(root, options(expert="static")))
    assert "expert = 'static'" in message
    assert "expert = 'adaptive'" in message


def test_a_collection_that_never_recorded_anything_binds_nobody(tmp_path: Path, options: Options) -> None:
    root = tmp_path / "dataset"
    with pytest.raises(WorkerError):
        collect(root, options(env_options={"broken": True}))
    assert collect(root, options(), max_attempts=ATTEMPTS).episodes == 6


def test_a_folder_of_something_else_is_not_touched(tmp_path: Path, options: Options, refuses: Refuses) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    refuses(DatasetError, lambda: collect(tmp_path, options()))
    assert (tmp_path / "thesis.tex").read_text() == "precious"


def test_only_one_collection_at_a_time(tmp_path: Path, options: Options, refuses: Refuses) -> None:
    root = tmp_path / "dataset"
    process = start(tmp_path, root, options(env_options={"delay": 0.3}, episodes_per_object=50), workers=1)
    try:
        wait_for(CollectionPaths(root).partial_manifest.exists)
        message = refuses(DatasetError, lambda: collect(root, options()))
        assert "Another collection" in message
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def test_a_worker_that_dies_once_costs_nothing(tmp_path: Path, options: Options, finished: Path) -> None:
    root = tmp_path / "dataset"
    summary = collect(root, options(env_options={"crash": f"once:{tmp_path / 'marker'}"}), max_attempts=ATTEMPTS)
    assert (tmp_path / "marker").exists()
    assert summary.recorded == 6
    (root / "meta" / "collection.json").write_text((finished / "meta" / "collection.json").read_text())
    same_content(finished, root)


def test_an_object_that_kills_its_workers_is_reported(tmp_path: Path, options: Options, refuses: Refuses) -> None:
    deadly = options(env_options={"crash": "fake_001"}, episodes_per_object=1)
    message = refuses(DatasetError, lambda: collect(tmp_path / "dataset", deadly, max_attempts=ATTEMPTS))
    assert "fake_001, episode 0" in message
    assert "SIGKILL" in message


def test_what_cannot_be_recorded_is_reported_and_left_out_only_on_request(
    tmp_path: Path, options: Options, refuses: Refuses
) -> None:
    hopeless = options(env_options={"hopeless": "fake_001"}, episodes_per_object=2)
    root = tmp_path / "dataset"
    message = refuses(DatasetError, lambda: collect(root, hopeless, max_attempts=ATTEMPTS))
    assert "fake_001, episode 0" in message
    assert "unreachable" in message
    assert not root.exists()
    summary = collect(root, hopeless, max_attempts=2, allow_missing=True)
    assert summary.episodes == 2
    assert len(summary.failures) == 2


def test_an_environment_that_cannot_be_built_ends_the_collection_with_its_reason(
    tmp_path: Path, options: Options
) -> None:
    with pytest.raises(WorkerError, match="no simulator here"):
        collect(tmp_path / "dataset", options(env_options={"broken": True}))


def test_the_expert_decides_the_data_but_not_the_episodes(tmp_path: Path, options: Options, finished: Path) -> None:
    from lerobot_adamanip.demos.loading import episode_table

    collect(tmp_path / "dataset", options(expert="static"), max_attempts=ATTEMPTS)
    adaptive, static = (episode_table(root).to_pylist() for root in (finished, tmp_path / "dataset"))
    assert [row["seed"] for row in adaptive] == [row["seed"] for row in static]
    assert all(row["trials"] == 1 for row in static)
    assert any(row["trials"] == 2 for row in adaptive)


def test_the_fake_options_name_importable_factories() -> None:
    from lerobot_adamanip.demos.worker import resolve

    assert callable(resolve(OPTIONS["env_factory"]))
    assert callable(resolve(OPTIONS["expert_factory"]))


def test_all_categories_make_one_dataset_of_what_each_gives_alone(tmp_path: Path, options: Options) -> None:
    told: dict[str, list[int]] = {}
    names = ("fake_000", "fake_001", "mock_000")
    everything = options(category="all", objects=names, episodes_per_object=2)
    assert [everything.category_of(name) for name in names] == ["fake", "fake", "mock"]
    summary = collect(
        tmp_path / "all",
        everything,
        workers=2,
        max_attempts=ATTEMPTS,
        listener=lambda stage, done, total: told.setdefault(stage, []).append(done),
    )
    assert {name: row.episodes for name, row in summary.categories.items()} == {"fake": 4, "mock": 2}
    assert told["record fake"] == sorted(told["record fake"])
    assert (told["record fake"][-1], told["record mock"][-1], told["record"][-1]) == (4, 2, 6)
    alone = collect(
        tmp_path / "mock", options(category="mock", objects=("mock_000",), episodes_per_object=2), max_attempts=ATTEMPTS
    )
    assert alone.categories["mock"].attempts == summary.categories["mock"].attempts
    rows = [row for row in episode_table(tmp_path / "all").to_pylist() if row["object_id"] == "mock_000"]
    for row, other in zip(rows, episode_table(tmp_path / "mock").to_pylist(), strict=True):
        assert {key: row[key] for key in ("seed", "length", "hidden_state")} == {
            key: other[key] for key in ("seed", "length", "hidden_state")
        }
