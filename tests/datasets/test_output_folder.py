"""Output folders: resolved, locked and probed before work begins; nothing of another command is replaced or removed."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path
from typing import Any

import demos_fake_env
import pytest
from demos_helpers import InThisProcess, another, fakes, make_spec, patiently, same_bytes

from lerobot_adamanip.collection import executors
from lerobot_adamanip.collection.collect import CollectOptions, collect
from lerobot_adamanip.collection.parts import Part
from lerobot_adamanip.collection.render import add_pictures
from lerobot_adamanip.datasets import output_folder
from lerobot_adamanip.datasets.collection_spec import CollectionPaths
from lerobot_adamanip.datasets.filter import filter_episodes
from lerobot_adamanip.datasets.merge import merge
from lerobot_adamanip.datasets.output_folder import COLLECTING, WORK_FOLDERS, lock_output, lock_path, owned_output
from lerobot_adamanip.datasets.reading import episode_table, load_check
from lerobot_adamanip.datasets.repair import repair
from lerobot_adamanip.datasets.selection import selection_path
from lerobot_adamanip.datasets.split import split_episodes
from lerobot_adamanip.recordings.convert import ConvertOptions, convert
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

Refuses = Callable[[type, Callable[[], Any]], str]
BARE = make_spec(observe_images=False)


@pytest.fixture(autouse=True)
def _here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "WorkerPool", InThisProcess)


def writers(source: Path) -> dict[str, Callable[[Path], object]]:
    """Every command that writes a dataset, by its name."""
    return {
        "collect": lambda out: collect(out, BARE, fakes(), patiently()),
        "render": lambda out: add_pictures(source, out, demos_fake_env.make_env),
        "filter": lambda out: filter_episodes(source, ["episode_index=0"], out),
        "split": lambda out: split_episodes(source, out, None, by="object_id"),
        "merge": lambda out: merge([source, another(source, out.parent / "another")], out),
        "keyframes": lambda out: convert([source], out),
    }


COMMANDS = tuple(writers(Path()))


def record_part(root: Path) -> dict[str, bytes]:
    """Records half of a collection; returns its episode files."""
    collect(root, BARE, fakes(), patiently(part=Part(1, 2)))
    return {path.name: path.read_bytes() for path in CollectionPaths(root).episodes.iterdir()}


HOLDS = """
import os, sys, time
from pathlib import Path
from lerobot_adamanip.datasets.output_folder import lock_output
with lock_output(Path(sys.argv[1])):
    if not os.fork():
        print(os.getpid(), flush=True)
    time.sleep(60)
"""


def test_a_killed_command_leaves_no_lock_to_what_it_has_forked(tmp_path: Path, refuses: Refuses) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLDS, str(tmp_path / "out")], stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        child = int(holder.stdout.readline())
        refuses(DatasetError, lambda: contextlib.ExitStack().enter_context(lock_output(tmp_path / "out")))
        holder.kill()
        holder.wait()
        try:
            os.kill(child, 0)  # lives on, as an encoder does
            with lock_output(tmp_path / "out"):
                pass
        finally:
            os.kill(child, 9)


@pytest.mark.parametrize("command", COMMANDS[1:])
def test_an_unfinished_collection_owns_its_folder(
    unpictured: Path, tmp_path: Path, command: str, refuses: Refuses
) -> None:
    before = record_part(tmp_path / "dataset")
    said = refuses(DatasetError, lambda: writers(unpictured)[command](tmp_path / "dataset"))
    assert "An unfinished `adamanip collect` waits" in said
    assert {path.name: path.read_bytes() for path in CollectionPaths(tmp_path / "dataset").episodes.iterdir()} == before
    collect(tmp_path / "dataset", BARE, fakes(), patiently())
    same_bytes(unpictured, tmp_path / "dataset")


def test_a_part_of_a_dataset_is_no_finished_collection(unpictured: Path, tmp_path: Path, refuses: Refuses) -> None:
    root = tmp_path / "dataset"
    before = record_part(root)
    filter_episodes(unpictured, ["episode_index=0:2"], tmp_path / "part")
    (tmp_path / "part").rename(root)
    assert "a part of a dataset" in refuses(DatasetError, lambda: collect(root, BARE, fakes(), patiently()))
    assert {path.name: path.read_bytes() for path in CollectionPaths(root).episodes.iterdir()} == before
    selection_path(root).unlink()
    assert "does not have the episodes" in refuses(DatasetError, lambda: collect(root, BARE, fakes(), patiently()))
    assert load_check(root)["total_episodes"] == 2
    assert {path.name: path.read_bytes() for path in CollectionPaths(root).episodes.iterdir()} == before


def test_episodes_of_another_collection_stay_beside_a_finished_one(
    unpictured: Path, tmp_path: Path, refuses: Refuses
) -> None:
    root = tmp_path / "dataset"
    with pytest.raises(DatasetError):
        collect(root, make_spec(observe_images=False, seed=3), fakes(hopeless="safe_001"), patiently())
    before = sorted(CollectionPaths(root).episodes.iterdir())
    shutil.copytree(unpictured, root)
    assert collect(root, BARE, fakes(), patiently()).recorded == 0
    assert before == sorted(CollectionPaths(root).episodes.iterdir()) != []


def hopeless(**changes: Any) -> Any:
    """A collection that keeps nothing but failed episodes."""
    return make_spec(objects=("safe_000",), episodes_per_object=1, keep_failed=True, observe_images=False, **changes)


def failing_seed(tmp_path: Path) -> int:
    """Returns the seed of a collection whose first attempt fails, and is kept."""
    for seed in range(50):
        root = tmp_path / f"search{seed}"
        with contextlib.suppress(DatasetError):
            collect(root, hopeless(seed=seed), fakes(), CollectOptions(max_attempts=1))
        if list(CollectionPaths(root).failed_episodes.glob("*")):
            return seed
    raise AssertionError("no attempt failed")


def test_failed_episodes_of_another_collection_are_not_published(tmp_path: Path, refuses: Refuses) -> None:
    seed, root = failing_seed(tmp_path), tmp_path / "dataset"
    with pytest.raises(DatasetError, match="could not be recorded"):
        collect(root, hopeless(seed=seed), fakes(), CollectOptions(max_attempts=1))
    (kept,) = CollectionPaths(root).failed_episodes.iterdir()
    other = hopeless(seed=seed, expert="static")
    assert "expert = 'static'" in refuses(DatasetError, lambda: collect(root, other, fakes(), patiently()))
    assert "another fingerprint" in refuses(
        DatasetError, lambda: collect(root, hopeless(seed=seed), fakes(code="b"), patiently())
    )
    assert kept.exists()
    # One that got there all the same, under a name that fits.
    stray = tmp_path / "stray" / "dataset"
    with contextlib.suppress(DatasetError):
        collect(stray, hopeless(seed=1), fakes(code="b"), CollectOptions(max_attempts=1, part=Part(1, 1)))
    folder = CollectionPaths(stray).failed_episodes
    if not CollectionPaths(stray).episodes.exists():
        pytest.fail("nothing was prepared")
    shutil.rmtree(CollectionPaths(stray).partial)
    with contextlib.suppress(DatasetError):
        collect(stray, hopeless(seed=seed), fakes(code="b"), CollectOptions(max_attempts=1))
    (foreign,) = folder.iterdir()
    shutil.copy(foreign, kept.with_name(foreign.name.replace("-000.", "-009.")))
    summary = collect(root, hopeless(seed=seed), fakes(), patiently())
    failed = episode_table(CollectionPaths(root).failed)
    assert failed["fingerprint"].to_pylist() == failed.num_rows * episode_table(root)["fingerprint"].to_pylist()
    assert failed.num_rows <= summary.attempted - 1


def test_accounts_of_another_collection_are_forgotten(tmp_path: Path) -> None:
    """Else `--adopt` would take an item for given up that this collection never tried."""
    root, one = tmp_path / "dataset", ("safe_000",)
    with pytest.raises(DatasetError, match="could not be recorded"):
        collect(root, make_spec(objects=one, seed=5), fakes(hopeless="safe_000"), CollectOptions(max_attempts=2))
    assert list(CollectionPaths(root).attempts.iterdir())
    collect(tmp_path / "part", make_spec(objects=one), fakes(), patiently(part=Part(1, 2)))
    options = patiently(adopt=(tmp_path / "part",), max_attempts=25)
    assert collect(root, make_spec(objects=one), fakes(), options).given_up == 0


def test_the_failed_episodes_of_another_collection_are_not_replaced(tmp_path: Path, refuses: Refuses) -> None:
    root, spec = tmp_path / "dataset", make_spec(keep_failed=True, observe_images=False)
    collect(root, spec, fakes(), patiently())
    root.rename(tmp_path / "elsewhere")
    before = (tmp_path / "dataset-failed" / "meta" / "info.json").read_bytes()
    other = make_spec(keep_failed=True, observe_images=False, seed=1)
    assert "seed = 1" in refuses(DatasetError, lambda: collect(root, other, fakes(), patiently()))
    assert (tmp_path / "dataset-failed" / "meta" / "info.json").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dataset-failed", "elsewhere"]


# Places ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["collect", "render", "filter", "split", "merge"])
def test_links_and_dots_lead_to_the_folder_that_they_name(unpictured: Path, tmp_path: Path, command: str) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "link").symlink_to(tmp_path / "disk" / "dataset")
    writers(unpictured)[command](tmp_path / "here" / ".." / "here" / "link")
    assert (tmp_path / "here" / "link").is_symlink()
    assert list((tmp_path / "disk" / "dataset").rglob("info.json"))
    assert sorted(path.name for path in (tmp_path / "disk").iterdir()) == ["dataset"]
    assert {path.name for path in (tmp_path / "here").iterdir()} <= {"link", "another"}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_that_cannot_be_written_is_one_error_before_any_work(
    unpictured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, refuses: Refuses
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    monkeypatch.setattr(demos_fake_env, "make_env", lambda *_, **__: pytest.fail("an environment was made"))
    other = another(unpictured, tmp_path / "other")
    run = writers(unpictured) | {"merge": lambda out: merge([unpictured, other], out)}
    for out in ("/proc/dataset", "/", "file/dataset", "loop/dataset"):
        said = refuses(DatasetError, lambda out=out: run[command](tmp_path / out))  # type: ignore[misc]
        assert "cannot be written there" in said


def test_a_mount_point_is_refused_before_anything_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Refuses
) -> None:
    """What renaming onto one says; making one needs rights that tests do not have."""
    (tmp_path / "dataset").mkdir()
    replace = os.replace

    def busy(source: Any, target: Any) -> None:
        if Path(target) == tmp_path / "dataset":
            raise OSError(16, "Device or resource busy")
        replace(source, target)

    monkeypatch.setattr(os, "replace", busy)
    said = refuses(DatasetError, lambda: collect(tmp_path / "dataset", BARE, fakes(), patiently()))
    assert "Device or resource busy" in said
    assert list(tmp_path.rglob("*.safetensors")) == []


@pytest.mark.parametrize("command", COMMANDS[:5])
def test_a_full_disk_is_refused_before_any_work(
    unpictured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, refuses: Refuses
) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(output_folder.shutil, "disk_usage", lambda _: usage(10, 10, 1000))
    said = refuses(DatasetError, lambda: writers(unpictured)[command](tmp_path / "dataset"))
    assert "not enough room" in said
    assert {path.name for path in tmp_path.iterdir()} <= {"another"}


@pytest.mark.parametrize("suffix", WORK_FOLDERS)
def test_a_folder_of_somebody_else_beside_it_is_not_touched(tmp_path: Path, suffix: str, refuses: Refuses) -> None:
    mine = tmp_path / f"dataset{suffix}" / "thesis.tex"
    mine.parent.mkdir()
    mine.touch()

    def enter() -> None:
        with owned_output(tmp_path / "dataset", suffix):
            pytest.fail("it was entered")

    assert "thesis.tex" in refuses(DatasetError, enter)
    assert mine.exists()


# One at a time ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", [*COMMANDS, "repair"])
def test_one_command_at_a_time(unpictured: Path, tmp_path: Path, command: str, refuses: Refuses) -> None:
    root = tmp_path / "dataset"
    if command == "repair":
        shutil.copytree(unpictured, root)
    with lock_output(root):
        run = repair if command == "repair" else writers(unpictured)[command]
        assert "Another command is at work" in refuses(DatasetError, lambda: run(root))
    assert not lock_path(root).exists()


def test_a_lock_of_a_process_that_died_binds_nobody(tmp_path: Path) -> None:
    lock_path(tmp_path / "dataset").touch()
    with owned_output(tmp_path / "dataset", COLLECTING):
        assert lock_path(tmp_path / "dataset").exists()
    assert list(tmp_path.iterdir()) == []


def test_what_a_recorder_is_writing_is_not_repaired(unpictured: Path, tmp_path: Path, refuses: Refuses) -> None:
    """LeRobot's own recorder of another robot locks nothing: it is found by its open files."""
    root = tmp_path / "dataset"
    shutil.copytree(unpictured, root)
    script = "import sys; file = open(sys.argv[1], 'wb'); print(flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", script, str(root / "data" / "new.parquet")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as recorder:
        assert recorder.stdout is not None
        recorder.stdout.readline()
        assert "is writing this dataset" in refuses(DatasetError, lambda: repair(root))
        assert (root / "data" / "new.parquet").exists()
    (root / "data" / "new.parquet").unlink()
    assert repair(root).mended == []


def test_a_read_only_part_is_adopted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unpictured: Path) -> None:
    record_part(tmp_path / "part")
    opened = os.open

    def read_only(path: Any, flags: int, *mode: int, **options: Any) -> int:
        if Path(path) == lock_path(tmp_path / "part"):
            raise OSError(30, "Read-only file system")
        return opened(path, flags, *mode, **options)

    monkeypatch.setattr(os, "open", read_only)
    assert collect(tmp_path / "dataset", BARE, fakes(), patiently(adopt=(tmp_path / "part",))).recorded == 3
    same_bytes(unpictured, tmp_path / "dataset")


# Pictures ---------------------------------------------------------------------------------------------------------


def test_pictures_of_another_dataset_are_not_taken_for_ones_own(
    unpictured: Path, tmp_path: Path, refuses: Refuses
) -> None:
    filter_episodes(unpictured, ["episode_index=3:6"], tmp_path / "part")
    out = tmp_path / "dataset"

    def stop(stage: str, done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        add_pictures(tmp_path / "part", out, demos_fake_env.make_env, progress=stop)
    left = {path.name: path.read_bytes() for path in (tmp_path / "dataset.rendering").rglob("*.safetensors")}
    said = refuses(DatasetError, lambda: add_pictures(unpictured, out, demos_fake_env.make_env))
    assert "Pictures of another dataset" in said
    assert left == {path.name: path.read_bytes() for path in (tmp_path / "dataset.rendering").rglob("*.safetensors")}
    assert add_pictures(tmp_path / "part", out, demos_fake_env.make_env) == 3
    assert selection_path(out).read_bytes() == selection_path(tmp_path / "part").read_bytes()


# Names ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["my data", "a/b/c", "../x", "u/a--b", "", "x" * 97])
def test_names_that_the_hub_refuses_are_refused_first(tmp_path: Path, name: str, refuses: Refuses) -> None:
    calls: list[Callable[[], object]] = [
        lambda: CollectOptions(repo_id=name),
        lambda: add_pictures(tmp_path, tmp_path / "a", demos_fake_env.make_env, repo_id=name),
        lambda: filter_episodes(tmp_path, [], tmp_path / "a", repo_id=name),
        lambda: merge([tmp_path, tmp_path], tmp_path / "a", repo_id=name),
        lambda: convert([tmp_path], tmp_path / "a", ConvertOptions(repo_id=name)),
    ]
    for call in calls:
        assert "The Hub takes no repository of this name" in refuses(ConfigurationError, call)
    assert list(tmp_path.iterdir()) == []
