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
from demos_helpers import another, fakes, make_spec, patiently, same_bytes

from lerobot_adamanip.collection.collect import CollectOptions, collect
from lerobot_adamanip.collection.partial import Part
from lerobot_adamanip.collection.render import add_pictures
from lerobot_adamanip.datasets import output_folder
from lerobot_adamanip.datasets.collection_spec import CollectionPaths
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.editing import filter_episodes, merge, split_episodes
from lerobot_adamanip.datasets.output_folder import COLLECTING, WORK_FOLDERS, lock_output, lock_path, owned_output
from lerobot_adamanip.datasets.repair import repair
from lerobot_adamanip.datasets.selection import selection_path
from lerobot_adamanip.recordings.convert import ConvertOptions, convert
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

Refuses = Callable[[type, Callable[[], Any]], str]
BARE = make_spec(observe_images=False)


pytestmark = pytest.mark.usefixtures("in_process")


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


def held(root: Path) -> dict[str, bytes]:
    """Returns the episode files of an unfinished collection."""
    return {path.name: path.read_bytes() for path in CollectionPaths(root).episodes.iterdir()}


def record_part(root: Path) -> dict[str, bytes]:
    """Records half of a collection; returns its episode files."""
    collect(root, BARE, fakes(), patiently(part=Part(1, 2)))
    return held(root)


@pytest.mark.parametrize("command", [*COMMANDS, "repair"])
def test_every_command_refuses_before_any_work(
    unpictured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, refuses: Refuses
) -> None:
    out, other = tmp_path / "dataset", another(unpictured, tmp_path / "another")
    run = {**writers(unpictured), "merge": lambda out: merge([unpictured, other], out), "repair": repair}[command]
    if command == "repair":
        shutil.copytree(unpictured, out)
    with lock_output(out):
        assert "Another command is at work" in refuses(DatasetError, lambda: run(out))
    assert not lock_path(out).exists()
    if command == "repair":
        return
    (tmp_path / "file").touch()
    with monkeypatch.context() as patch:
        patch.setattr(demos_fake_env, "make_env", lambda *_, **__: pytest.fail("an environment was made"))
        assert "cannot be written there" in refuses(DatasetError, lambda: run(tmp_path / "file" / "dataset"))
        assert "cannot be written there" in refuses(DatasetError, lambda: run(tmp_path / ("n" * 300) / "dataset"))
        assert "lies in a dataset" in refuses(DatasetError, lambda: run(other / "new" / "dataset"))
    if command != "keyframes":  # its source has to be a recording
        usage = namedtuple("usage", "total used free")
        with monkeypatch.context() as patch:
            patch.setattr(output_folder.shutil, "disk_usage", lambda _: usage(10, 10, 1000))
            assert "not enough room" in refuses(DatasetError, lambda: run(out))
    assert {path.name for path in tmp_path.iterdir()} == {"another", "file"}


@pytest.mark.parametrize("command", COMMANDS[1:])
def test_an_unfinished_collection_owns_its_folder(
    unpictured: Path, tmp_path: Path, command: str, refuses: Refuses
) -> None:
    episodes = CollectionPaths(tmp_path / "dataset").episodes
    episodes.mkdir(parents=True)
    (episodes / "safe_000-00000.safetensors").touch()
    said = refuses(DatasetError, lambda: writers(unpictured)[command](tmp_path / "dataset"))
    assert "An unfinished `adamanip collect` waits" in said
    assert list(episodes.iterdir())


# Places ---------------------------------------------------------------------------------------------------------------


def test_links_and_dots_lead_to_the_folder_that_they_name(unpictured: Path, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "link").symlink_to(tmp_path / "disk" / "dataset")
    filter_episodes(unpictured, ["episode_index=0"], tmp_path / "here" / ".." / "here" / "link")
    assert (tmp_path / "here" / "link").is_symlink()
    assert Dataset(tmp_path / "disk" / "dataset")
    assert [path.name for folder in ("disk", "here") for path in (tmp_path / folder).iterdir()] == ["dataset", "link"]


@pytest.mark.parametrize("out", ["/proc/dataset", "/", "loop/dataset"])
def test_a_folder_that_cannot_be_written_is_one_error(tmp_path: Path, out: str, refuses: Refuses) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    refused = owned_output(tmp_path / out, COLLECTING)
    assert "cannot be written there" in refuses(DatasetError, lambda: contextlib.ExitStack().enter_context(refused))


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


def test_a_lock_of_a_process_that_died_binds_nobody(tmp_path: Path) -> None:
    lock_path(tmp_path / "dataset").touch()
    with owned_output(tmp_path / "dataset", COLLECTING):
        assert lock_path(tmp_path / "dataset").exists()
    assert list(tmp_path.iterdir()) == []


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


# Episodes of another collection -----------------------------------------------------------------------------------


def test_a_part_of_a_dataset_is_no_finished_collection(unpictured: Path, tmp_path: Path, refuses: Refuses) -> None:
    root = tmp_path / "dataset"
    before = record_part(root)
    filter_episodes(unpictured, ["episode_index=0:2"], tmp_path / "part")
    (tmp_path / "part").rename(root)
    assert "does not have the episodes" in refuses(DatasetError, lambda: collect(root, BARE, fakes(), patiently()))
    assert len(Dataset(root)) == 2
    assert held(root) == before


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


def test_failed_episodes_of_another_collection_are_not_published(tmp_path: Path, refuses: Refuses) -> None:
    for seed in range(50):  # until the only attempt fails, and is kept
        root = tmp_path / str(seed)
        with contextlib.suppress(DatasetError):
            collect(root, hopeless(seed=seed), fakes(), CollectOptions(max_attempts=1))
        if kept := list(CollectionPaths(root).failed_episodes.glob("*")):
            break
    other = hopeless(seed=seed, expert="static")
    assert "expert = 'static'" in refuses(DatasetError, lambda: collect(root, other, fakes(), patiently()))
    changed = fakes(code="b")
    assert "other versions" in refuses(DatasetError, lambda: collect(root, hopeless(seed=seed), changed, patiently()))
    assert all(path.exists() for path in kept)
    summary = collect(root, hopeless(seed=seed), fakes(), patiently())
    assert Dataset(CollectionPaths(root).failed).table.num_rows == summary.attempted - 1


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
        assert "The Hub does not accept this repository name" in refuses(ConfigurationError, call)
    assert list(tmp_path.iterdir()) == []
