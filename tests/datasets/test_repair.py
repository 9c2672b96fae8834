"""What LeRobot's own recorder leaves when it is killed: every episode whose saving had ended is there again."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.contract.rotations import pose_vector, rotation_about, transform
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.check.repair import repair
from lerobot_adamanip.datasets.check.salvage import salvage
from lerobot_adamanip.datasets.check.thrift import Reader, Writer
from lerobot_adamanip.datasets.reading import load_check, open_dataset
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError

POINTS, PIXELS, REPO = 24, 64, "local/killed"
LENGTHS = (5, 7, 4, 6)


class KilledError(Exception):
    """Stands for the end of the process: the folder is looked at as it is then."""


def frame(episode: int, row: int) -> dict[str, Any]:
    draw = np.random.default_rng([episode, row])
    turned = transform(draw.uniform(0.4, 0.6, 3), rotation_about(draw.normal(size=3), draw.uniform(0, 3)))
    pose = pose_vector(turned, float(draw.random()))
    lower, upper = DEFAULT_WORKSPACE.lower, DEFAULT_WORKSPACE.upper
    labels = {key: np.zeros(1, dtype) for key, dtype in schema.LABEL_DTYPES.items()}
    return {
        schema.POINT_CLOUD: draw.uniform(lower, upper, (POINTS, 3)).astype(np.float32).reshape(-1),
        schema.STATE: np.concatenate([pose, draw.normal(size=14)]).astype(np.float32),
        schema.EFFORT: draw.normal(size=7).astype(np.float32),
        schema.FRONT_IMAGE: np.full((PIXELS, PIXELS, 3), 30 + 40 * episode, np.uint8),
        schema.ACTION: pose,
        schema.EXECUTED: pose,
        schema.JOINTS: np.zeros(len(schema.JOINT_NAMES), np.float32),
        **labels,
        schema.DONE: np.array([row == LENGTHS[episode] - 1]),
        "task": f"open number {episode % 2}",
    }


def begun(root: Path) -> Any:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset.create(REPO, schema.FPS, schema.dataset_features(POINTS, PIXELS), root=root)


def resumed(root: Path) -> Any:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset.resume(REPO, root=root)


def add(dataset: Any, episode: int, rows: int | None = None) -> None:
    for row in range(LENGTHS[episode] if rows is None else rows):
        dataset.add_frame(frame(episode, row))


def save(dataset: Any, *episodes: int) -> None:
    for episode in episodes:
        add(dataset, episode)
        dataset.save_episode()


def raises(*_: Any, **__: Any) -> Any:
    raise KilledError


def in_an_episode(root: Path, _: pytest.MonkeyPatch) -> Any:
    dataset = begun(root)
    save(dataset, 0, 1, 2)
    add(dataset, 3, 2)
    return dataset


def before_its_video(root: Path, patch: pytest.MonkeyPatch) -> Any:
    dataset = begun(root)
    save(dataset, 0, 1, 2)
    patch.setattr(dataset.writer, "_save_episode_video", raises)
    add(dataset, 3)
    with pytest.raises(KilledError):
        dataset.save_episode()
    return dataset


def before_its_metadata(root: Path, patch: pytest.MonkeyPatch) -> Any:
    dataset = begun(root)
    save(dataset, 0, 1, 2)
    patch.setattr(dataset.meta, "save_episode", raises)
    add(dataset, 3)
    with pytest.raises(KilledError):
        dataset.save_episode()
    return dataset


def while_finishing(root: Path, patch: pytest.MonkeyPatch) -> Any:
    dataset = begun(root)
    save(dataset, 0, 1, 2)
    patch.setattr(dataset.meta, "finalize", raises)
    with pytest.raises(KilledError):
        dataset.finalize()
    return dataset


def while_describing(root: Path, patch: pytest.MonkeyPatch) -> Any:
    dataset = in_an_episode(root, patch)
    content = (root / "meta" / "info.json").read_bytes()
    (root / "meta" / "info.json").write_bytes(content[:-20])
    (root / "meta" / "stats.json").write_bytes(b"")
    dataset.writer.close_writer()
    return dataset


def in_a_second_session(root: Path, _: pytest.MonkeyPatch) -> Any:
    first = begun(root)
    save(first, 0, 1)
    first.finalize()
    dataset = resumed(root)
    save(dataset, 2)
    add(dataset, 3, 2)
    return dataset


KILLS = {
    in_an_episode: 3, before_its_video: 3, before_its_metadata: 4, while_finishing: 3, while_describing: 3,
    in_a_second_session: 3,
}  # fmt: skip
"""How a recording ends, and the episodes that are there in full: rows and frames."""


@pytest.mark.parametrize(("kill", "episodes"), KILLS.items(), ids=[kill.__name__ for kill in KILLS])
def test_every_saved_episode_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kill: Callable[[Path, pytest.MonkeyPatch], Any], episodes: int
) -> None:
    dataset = kill(tmp_path / "recording", monkeypatch)
    root = Path(shutil.copytree(tmp_path / "recording", tmp_path / "killed"))  # as it is at this moment
    monkeypatch.undo()
    dataset.finalize()
    assert not check(root).clean
    done = repair(root)
    assert done.left == []
    assert check(root).findings == ()
    found = open_dataset(root, video_backend="pyav")
    assert (found.num_episodes, len(found)) == (episodes, sum(LENGTHS[:episodes]))
    row = 0
    for episode in range(episodes):
        for number in range(LENGTHS[episode]):
            item, wanted = found[row], frame(episode, number)
            for key in (schema.POINT_CLOUD, schema.STATE, schema.ACTION):
                np.testing.assert_array_equal(item[key], wanted[key])
            assert item["task"] == wanted["task"]
            assert abs(float(item[schema.FRONT_IMAGE].mean()) - (30 + 40 * episode) / 255) < 0.02
            row += 1
    # What it took out lies beside it.
    assert done.backup.is_dir()


def test_recording_goes_on_after_a_repair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = in_an_episode(tmp_path / "recording", monkeypatch)
    root = Path(shutil.copytree(tmp_path / "recording", tmp_path / "killed"))
    dataset.finalize()
    repair(root)
    again = resumed(root)
    save(again, 3)
    again.finalize()
    assert load_check(root)["total_episodes"] == 4
    assert check(root).clean


def recorded(root: Path, cloud: tuple[int, ...]) -> Path:
    """Three episodes whose clouds have this shape, as LeRobot records them."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = schema.dataset_features(POINTS, images=False)
    features[schema.POINT_CLOUD]["shape"] = cloud
    dataset = LeRobotDataset.create(REPO, schema.FPS, features, root=root)
    for episode in range(3):
        for row in range(LENGTHS[episode]):
            values = {key: value for key, value in frame(episode, row).items() if key in (*features, "task")}
            dataset.add_frame({**values, schema.POINT_CLOUD: values[schema.POINT_CLOUD].reshape(cloud)})
        dataset.save_episode()
    dataset.finalize()
    return root


@pytest.mark.parametrize("writes", [0, 1, 2, 3, None])
def test_clouds_of_version_0_2_are_stored_as_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writes: int | None
) -> None:
    """Whatever interrupts it: after so many files, or nothing."""
    old, new = recorded(tmp_path / "old", (POINTS, 3)), recorded(tmp_path / "new", (3 * POINTS,))
    assert ["adamanip repair" in finding.message for finding in check(old).findings] == [True]
    with pytest.raises(DatasetError, match="adamanip repair"):
        load_check(old)
    if writes is not None:
        left, write = iter(range(writes)), files.write_atomically
        monkeypatch.setattr(
            files, "write_atomically", lambda *given: raises() if next(left, None) is None else write(*given)
        )
        with pytest.raises(KilledError):
            repair(old)
        monkeypatch.undo()
    mended = repair(old)
    assert mended.left == []
    assert check(old).findings == ()
    for name in ("data/chunk-000/file-000.parquet", "meta/tasks.parquet"):
        assert pq.read_table(old / name).equals(pq.read_table(new / name))
    assert json.loads((old / "meta" / "info.json").read_text()) == json.loads((new / "meta" / "info.json").read_text())
    assert open_dataset(old)[3][schema.POINT_CLOUD].shape == (3 * POINTS,)
    assert repair(old).mended == []


def test_rows_of_a_file_without_its_end(tmp_path: Path) -> None:
    dataset = begun(tmp_path / "recording")
    save(dataset, 0, 1, 2)
    path = tmp_path / "recording" / "data" / "chunk-000" / "file-000.parquet"
    features = json.loads((tmp_path / "recording" / "meta" / "info.json").read_text())["features"]
    left = path.read_bytes()
    dataset.finalize()
    whole = pq.read_table(path)
    (tmp_path / "cut").write_bytes(left)
    saved = salvage(tmp_path / "cut", features)
    assert saved is not None
    assert saved[1] == sum(LENGTHS[:3])
    assert pq.read_table(io.BytesIO(saved[0])).equals(whole)
    for share in (0.2, 0.5, 0.9, 0.99):  # whole episodes, whatever is left of the file
        (tmp_path / "cut").write_bytes(left[: int(share * len(left))])
        saved = salvage(tmp_path / "cut", features)
        rows = 0 if saved is None else saved[1]
        assert rows in (0, *np.cumsum(LENGTHS[:3]).tolist())
        assert rows < len(whole)
        if saved is not None:
            assert pq.read_table(io.BytesIO(saved[0])).equals(whole.slice(0, rows))
    (tmp_path / "cut").write_bytes(b"nothing of the kind")
    assert salvage(tmp_path / "cut", features) is None


def test_a_footer_is_read_and_written_as_it_is() -> None:
    sink = io.BytesIO()
    table = pa.table({"a": [1, 2], "b": [[True], [False, None]], "c": ["x", None]})
    pq.write_table(table, sink, row_group_size=1)
    content = sink.getvalue()
    footer = content[-8 - int.from_bytes(content[-8:-4], "little") : -8]
    assert bytes(Writer().struct(Reader(footer).struct())) == footer
    for end in range(0, len(footer), 7):
        with pytest.raises((IndexError, ValueError)):
            Reader(footer[:end]).struct()
