from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from demos_helpers import fakes

from lerobot_adamanip.cli.replay import ReplayCommand
from lerobot_adamanip.collection.replay import replay
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_env_adamanip import make_environment as factory

ENV = fakes().environment
Refuses = Callable[[type, Callable[[], Any]], str]


def test_every_recorded_episode_happens_again_exactly(finished: Path) -> None:
    for row in Dataset(finished).table.to_pylist():
        result = replay(finished, row["episode_index"], ENV)
        assert result.agrees(0.0)
        assert (result.object_id, result.seed) == (row["object_id"], row["seed"])
        assert result.replayed == result.key_frames == row["length"] - 1  # the last row is terminal
        assert result.changed == ()


def test_a_recording_of_other_versions_is_compared_and_said_to_be_one(
    finished: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    result = replay(finished, 0, fakes(code="b").environment)
    assert result.changed == ("code",)
    assert result.agrees(0.0)
    monkeypatch.setattr(factory, "make_environment", fakes(code="b").environment)
    assert ReplayCommand(root=finished, episode=0).run() == 0
    printed = capsys.readouterr()
    assert "Recorded with other versions: code differ." in printed.out
    assert "replayed: " in printed.err  # progress without a terminal


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command builds the fake environment."""
    monkeypatch.setattr(factory, "make_environment", ENV)


@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize("change", [0.5, np.nan])
def test_a_changed_recording_is_noticed(change: float, tmp_path: Path, finished: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    root = Path(shutil.copytree(finished, tmp_path / "copy"))
    path = root / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    states = np.array(table[schema.STATE].to_pylist(), dtype=np.float32)
    states[1, 5] += change
    index = table.column_names.index(schema.STATE)
    changed = pa.array(list(states), type=table.schema.field(schema.STATE).type)
    pq.write_table(table.set_column(index, table.schema.field(index), changed), path)
    result = replay(root, 0, ENV)
    assert result.differences[schema.STATE] == pytest.approx(change, nan_ok=True)
    assert result.differences[schema.POINT_CLOUD] == 0.0
    assert not result.agrees(0.1)
    assert ReplayCommand(root=root, episode=0).run() == 1
    assert ReplayCommand(root=root, episode=0, tolerance=1.0).run() == int(np.isnan(change))


@pytest.mark.usefixtures("fake")
def test_the_command_prints_one_object_and_writes_a_video(
    tmp_path: Path, finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    video = tmp_path / "videos" / "out.mp4"
    assert ReplayCommand(root=finished, episode=1, out=video, json=True).run() == 0
    content = json.loads(capsys.readouterr().out)
    assert content["agrees"] is True
    assert content["success"] is True
    with av.open(str(video)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == content["key_frames"] + 1
    assert frames[0].shape == (64, 128, 3)
    left, right = frames[0][:, :64].astype(int), frames[0][:, 64:].astype(int)
    assert np.abs(left - right).mean() < 12.0  # recording and replay show the same


def test_episodes_and_datasets_that_are_not_there(tmp_path: Path, finished: Path, refuses: Refuses) -> None:
    assert "0 to 5" in refuses(ConfigurationError, lambda: replay(finished, 6, ENV))
    refuses(ConfigurationError, lambda: replay(finished, -1, ENV))
    refuses(DatasetError, lambda: replay(tmp_path / "nothing", 0, ENV))
