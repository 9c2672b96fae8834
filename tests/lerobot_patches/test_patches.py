"""The four patches of LeRobot: on where a robot of ours is created, in any order of imports, and off with one line."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.dataset_writer import DatasetWriter
from lerobot.datasets.video_utils import StreamingVideoEncoder
from lerobot.rollout import context
from lerobot.scripts import lerobot_record
from lerobot.utils.feature_utils import build_dataset_frame

from lerobot_adamanip import lerobot_patches
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import POSE, STATES
from lerobot_adamanip.contract.memory import MEMORY, MEMORY_NAMES, memory_feature
from lerobot_adamanip.hardware.features import recorded_features
from lerobot_adamanip.lerobot_patches import NO_PATCHES, PATCHES, support

ORDERS = (
    ("import lerobot_env_adamanip", "import lerobot.scripts.lerobot_record"),
    ("import lerobot.scripts.lerobot_record", "import lerobot_env_adamanip"),
)
ROBOT = """
import json
import lerobot.datasets.lerobot_dataset as datasets, lerobot.scripts.lerobot_record as recorder
from lerobot.datasets.dataset_writer import DatasetWriter
def changed():
    return [datasets.DatasetWriter is not DatasetWriter, hasattr(datasets.LeRobotDataset.resume, "__wrapped__"),
            recorder.record_loop.__code__.co_filename.endswith("episode_signals.py")]
before = changed()
from lerobot.robots import make_robot_from_config
from lerobot_adamanip.hardware.adamanip_franka.config_adamanip_franka import AdamanipFrankaConfig
make_robot_from_config(AdamanipFrankaConfig(id="left", address="127.0.0.1"))
print(json.dumps([before, changed()]))
"""


@pytest.fixture(autouse=True)
def lerobot_as_it_is(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Each test begins, and ends, with LeRobot as it is; the variable is unset whatever it is for the other tests."""
    monkeypatch.delenv(NO_PATCHES, raising=False)
    lerobot_patches.restore()
    yield
    lerobot_patches.restore()


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    lines: list[str] = []
    monkeypatch.setattr(support._log, "warning", lines.append)
    monkeypatch.setattr(support, "_warned", set())
    return lines


def stock() -> dict[str, Any]:
    return {
        "writer": lerobot_dataset.DatasetWriter,
        "create": vars(lerobot_dataset.LeRobotDataset)["create"],
        "resume": vars(lerobot_dataset.LeRobotDataset)["resume"],
        "comparison": lerobot_record.sanity_check_dataset_robot_compatibility,
        "loop": lerobot_record.record_loop,
        "observations": context.hw_to_dataset_features,
        "rollout": context.combine_feature_dicts,
    }


def record(root: Path, episodes: int) -> Any:
    """A recording with our robots' columns that is not finalized."""
    names = {schema.STATE: STATES[POSE], schema.ACTION: schema.POSE_NAMES}
    features = {key: {"dtype": "float32", "shape": (len(each),), "names": list(each)} for key, each in names.items()}
    features = recorded_features(features)
    zeros = {key: np.zeros(feature["shape"], feature["dtype"]) for key, feature in features.items()}
    dataset = lerobot_dataset.LeRobotDataset.create("local/recording", 30, features, root=root)
    for _ in range(episodes):
        dataset.add_frame({**zeros, "task": "open it"})
        dataset.save_episode()
    return dataset


def is_readable(root: Path) -> bool:
    try:
        return all(pq.read_metadata(path).num_rows for path in root.rglob("*.parquet"))
    except Exception:
        return False


@pytest.mark.parametrize(
    "order",
    [pytest.param(ORDERS[0], id="plugin first", marks=pytest.mark.nightly), pytest.param(ORDERS[1], id="plugin last")],
)
def test_a_robot_is_recorded_durably_in_any_order_of_imports(order: tuple[str, ...]) -> None:
    """Importing alone changes nothing."""
    environment = {key: value for key, value in os.environ.items() if key != NO_PATCHES}
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(order) + ROBOT], capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert json.loads(done.stdout.splitlines()[-1]) == [[False] * 3, [True] * 3]


def test_patches_change_lerobot_once_and_are_taken_back(said: list[str]) -> None:
    before = stock()
    lerobot_patches.apply()
    after = stock()
    assert all(after[key] is not before[key] for key in before)
    lerobot_patches.apply()
    assert stock() == after
    assert said == []
    lerobot_patches.restore()
    assert stock() == before


def test_nothing_is_applied_before_its_module_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    before = stock()
    recorder = sys.modules.pop(PATCHES["episode_signals"][0])
    lerobot_patches.apply()
    assert lerobot_dataset.DatasetWriter is not before["writer"]
    assert lerobot_record.record_loop is before["loop"]
    sys.modules[PATCHES["episode_signals"][0]] = recorder
    lerobot_patches.apply()
    assert lerobot_record.record_loop is not before["loop"]


def test_one_variable_turns_all_off_with_one_line(
    monkeypatch: pytest.MonkeyPatch, said: list[str], tmp_path: Path
) -> None:
    monkeypatch.setenv(NO_PATCHES, "1")
    before = stock()
    lerobot_patches.apply()
    lerobot_patches.apply()
    assert stock() == before
    (line,) = said
    assert all(loss in line for _, loss in PATCHES.values())
    dataset = record(tmp_path / "recording", 2)
    assert not is_readable(tmp_path / "recording")  # until the session ends, as LeRobot has it
    dataset.finalize()
    assert is_readable(tmp_path / "recording")
    monkeypatch.setenv(NO_PATCHES, "0")
    lerobot_patches.apply()
    assert stock() != before


UNFIT = [
    ("durable_recording", (LeRobotDatasetMetadata, "_close_writer", None)),
    ("durable_recording", (DatasetWriter, "close_writer", lambda self: None)),  # files stay open
    ("ordered_depth", (StreamingVideoEncoder, "__init__", lambda self, depth_encoder: None)),
    ("rollout_memory", (context, "build_rollout_context", lambda cfg: None)),  # makes no features
    ("episode_signals", (lerobot_record, "record_loop", lambda session: None)),
    ("episode_signals", (lerobot_record, "record", lambda cfg: None)),  # has no loop
    ("episode_signals", (lerobot_record, "record", functools.partial(print))),  # has no code to read
]
"""Patch, and an attribute of LeRobot that another version has otherwise."""


@pytest.mark.parametrize(("off", "attribute"), UNFIT)
def test_a_patch_that_does_not_fit_is_off_alone_with_one_line(
    off: str, attribute: tuple[Any, str, Any], monkeypatch: pytest.MonkeyPatch, said: list[str]
) -> None:
    monkeypatch.setattr(*attribute)
    before = stock()
    lerobot_patches.apply()
    lerobot_patches.apply()
    (line,) = said
    assert line.startswith(f"The patch {off} does not fit this LeRobot (")
    assert line.endswith(PATCHES[off][1])
    assert lerobot_patches._on == set(PATCHES) - {off}
    assert (stock()["loop"] is before["loop"]) == (off == "episode_signals")
    assert (stock()["resume"] is before["resume"]) == (off == "durable_recording")
    assert (stock()["rollout"] is before["rollout"]) == (off == "rollout_memory")


def test_a_rollout_gives_the_memory_in_a_column_of_its_own() -> None:
    """As the environments do. LeRobot puts all numbers of a robot into the state."""
    offered = dict.fromkeys((*STATES[POSE], *MEMORY_NAMES), float)
    together = context.hw_to_dataset_features(offered, "observation")
    lerobot_patches.apply()
    for features in (context.hw_to_dataset_features(offered, "observation"), context.combine_feature_dicts(together)):
        assert features[schema.STATE]["names"] == list(STATES[POSE])
        assert features[MEMORY] == memory_feature()
    frame = build_dataset_frame(
        features, dict.fromkeys(MEMORY_NAMES, 1.0) | dict.fromkeys(STATES[POSE], 0.0), "observation"
    )
    assert (frame[schema.STATE].tolist(), frame[MEMORY].tolist()) == ([0.0] * 8, [1.0] * len(MEMORY_NAMES))


def test_depth_is_in_order_though_recordings_are_not_durable(
    monkeypatch: pytest.MonkeyPatch, said: list[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(DatasetWriter, "close_writer", lambda self: None)
    lerobot_patches.apply()
    monkeypatch.undo()
    dataset = record(tmp_path / "recording", 1)
    assert type(dataset.writer) is DatasetWriter
    assert "bframes=0" in dataset.writer._depth_encoder.extra_options["x265-params"]
    dataset.finalize()
