"""Two commands at one folder, in every order, the first one killed at every named point: nothing finished is lost."""

from __future__ import annotations

import contextlib
import functools
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import demos_fake_env
import pytest
from demos_helpers import InThisProcess, dies_at, fakes, make_spec, patiently, same_bytes

from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.collection.render import add_pictures
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.editing import filter_episodes
from lerobot_adamanip.datasets.output_folder import COLLECTING, RENDERING, lock_path
from lerobot_adamanip.datasets.repair import repair
from lerobot_adamanip.util import files, jobs
from lerobot_adamanip.util.errors import AdaManipError

SPEC = make_spec(episodes_per_object=1, image_size=16, observe_images=False, late_starts=0.0)
COMMANDS = ("render", "collect", "filter", "repair")
Run = Callable[[Path], object]
State = dict[str, bytes]


@pytest.fixture(scope="module", autouse=True)
def _here() -> object:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs, "WorkerPool", InThisProcess)
        yield


class Stage:
    """Commands that write to one folder, what each makes of it alone, and what is left of each where it is killed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.source = folder / "source" / "dataset"
        collect(self.source, SPEC, fakes(), patiently())
        self.run: dict[str, Run] = {
            "collect": lambda root: collect(root, SPEC, fakes(), patiently()),
            "render": lambda root: add_pictures(self.source, root, demos_fake_env.make_env),
            "filter": lambda root: filter_episodes(self.source, ["episode_index=0"], root),
            "repair": repair,
        }
        self.whole = {name: self._whole(name) for name in COMMANDS}
        self.killed = {name: self._killed(name) for name in COMMANDS}

    def prepare(self, name: str, root: Path) -> None:
        """Makes what a command expects at its folder: a repair, a damaged dataset; the others nothing."""
        root.parent.mkdir(parents=True)
        if name == "repair":
            shutil.copytree(self.source, root)
            (root / "meta" / ".info.json.1.tmp").touch()
            (root / "meta" / "stats.json").unlink()
            info = json.loads((root / "meta" / "info.json").read_text())
            (root / "meta" / "info.json").write_text(json.dumps({**info, "total_frames": 1}))

    def _whole(self, name: str) -> Path:
        root = self.folder / "whole" / name / "dataset"
        self.prepare(name, root)
        self.run[name](root)
        assert not lock_path(root).exists()
        return root

    def _killed(self, name: str) -> list[tuple[str, Path]]:
        """Returns the points that a command passes, and what it leaves if it is killed at each for the first time."""
        left: list[tuple[str, Path]] = []
        for point in files.CRASH_POINTS + files.REPAIR_POINTS:
            root = self.folder / "killed" / name / str(len(left)) / "dataset"
            self.prepare(name, root)
            if dies_at(functools.partial(self.run[name], root), point):
                left.append((point, root))
            else:
                shutil.rmtree(root.parent)
        return left


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory, _here: object) -> Stage:
    return Stage(tmp_path_factory.mktemp("stage"))


def episodes(root: Path) -> State:
    """Recorded or rendered episodes that wait beside a folder."""
    found: State = {}
    for suffix in (COLLECTING, RENDERING):
        folder = root.with_name(root.name + suffix)
        found |= {str(path.relative_to(root.parent)): path.read_bytes() for path in folder.rglob("*.safetensors")}
    return found


def contents(root: Path) -> State:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def is_dataset(root: Path) -> bool:
    with contextlib.suppress(AdaManipError):
        return bool(Dataset(root))
    return False


def is_equal(root: Path, whole: Path) -> bool:
    return contents(root) == contents(whole)


def test_the_points_are_many(stage: Stage) -> None:
    passed = {name: {point for point, _ in left} for name, left in stage.killed.items()}
    assert passed["collect"] == set(files.CRASH_POINTS)
    assert passed["render"] == set(files.CRASH_POINTS) - {"collection prepared", "all recorded"}
    assert len(passed["filter"]) >= 8
    assert passed["repair"] == set(files.REPAIR_POINTS)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        pytest.param(first, second, marks=() if second in (first, "repair") else pytest.mark.nightly)
        for first in COMMANDS
        for second in COMMANDS
    ],
)
def test_nothing_finished_is_lost(stage: Stage, tmp_path: Path, first: str, second: str) -> None:
    for number, (point, left) in enumerate(stage.killed[first]):
        root = tmp_path / str(number) / "dataset"
        shutil.copytree(left.parent, root.parent)
        waiting, there, whole = episodes(root), contents(root), is_dataset(root)
        try:
            stage.run[second](root)
            refused = False
        except AdaManipError:
            refused = True
        published = is_equal(root, stage.whole[first])
        assert published or waiting.items() <= episodes(root).items(), point
        if whole and first != "repair":
            assert contents(root) == there, point
        if first == second:
            assert published, point  # a second filter, or render, of what is finished is refused
            same_bytes(stage.whole[first], root)
            continue
        if refused or second == "repair" or whole:
            assert contents(root) == there or first == second, point
        else:
            assert is_equal(root, stage.whole[second]), point
            root.rename(tmp_path / str(number) / "second")
        if not published:
            stage.run[first](root)
        same_bytes(stage.whole[first], root)
