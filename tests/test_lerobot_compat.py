"""The faster reader gives what LeRobot's own gives, bit for bit, and reads our datasets only."""

from __future__ import annotations

import logging
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import torch
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import make_policy_config, make_pre_post_processors
from lerobot.utils.feature_utils import dataset_to_policy_features
from readers import FPS, assert_same, opened

from lerobot_adamanip import UNSCALED_POSES, columns, lerobot_compat, lerobot_version, schema
from lerobot_adamanip.columns import ColumnStore
from lerobot_adamanip.errors import ConfigurationError
from lerobot_adamanip.lerobot_reader import FastDatasetReader

LENGTHS = (5, 8, 2)
CAMERA, PICTURE = "observation.images.front", "observation.images.still"
FEATURES: dict[str, dict[str, Any]] = {
    "observation.point_cloud": {"dtype": "float32", "shape": (6, 3), "names": None},
    "observation.state": {"dtype": "float32", "shape": (4,), "names": None},
    "observation.precise": {"dtype": "float64", "shape": (2,), "names": None},
    "observation.bytes": {"dtype": "uint8", "shape": (3,), "names": None},
    "observation.touch": {"dtype": "bool", "shape": (1,), "names": None},
    "action": {"dtype": "float32", "shape": (schema.ACTION_DIM,), "names": list(schema.POSE_NAMES)},
    "complementary_info.phase": {"dtype": "int64", "shape": (1,), "names": None},
    "complementary_info.note": {"dtype": "string", "shape": (1,), "names": None},
    CAMERA: {"dtype": "video", "shape": (64, 64, 3), "names": ["height", "width", "channels"]},
    PICTURE: {"dtype": "image", "shape": (8, 8, 3), "names": ["height", "width", "channels"]},
}
BOTH_ENDS = {
    "observation.point_cloud": [-1, 0],
    "observation.precise": [0],
    "observation.bytes": [-2, 0],
    "observation.touch": [0, 1],
    "complementary_info.phase": [-1, 0, 1],
    "action": list(range(-3, 4)),
    CAMERA: [-1, 0],
    PICTURE: [0, 1],
}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Episodes of `LENGTHS` frames with every kind of column. Not to be written to."""
    rng, path = np.random.default_rng(5), tmp_path_factory.mktemp("reader") / "dataset"
    dataset = LeRobotDataset.create("local/reader", fps=FPS, features=FEATURES, root=path)
    for episode, length in enumerate(LENGTHS):
        for index in range(length):
            frame: dict[str, Any] = {"task": f"task {episode}", "complementary_info.note": f"{episode}.{index}"}
            for key, feature in FEATURES.items():
                shape, dtype = feature["shape"], feature["dtype"]
                if dtype in ("video", "image"):
                    frame[key] = rng.integers(0, 256, shape, dtype=np.uint8)
                elif dtype != "string":
                    frame[key] = rng.normal(scale=100, size=shape).astype(dtype)
            dataset.add_frame(frame)
        dataset.save_episode()
    dataset.finalize()
    return path


@pytest.fixture(autouse=True)
def _reader_as_before() -> Iterator[None]:
    was_applied = lerobot_dataset.DatasetReader is not DatasetReader
    yield
    (lerobot_compat.apply if was_applied else lerobot_compat.restore)()


@pytest.mark.parametrize("deltas", [None, BOTH_ENDS], ids=["rows", "windows"])
@pytest.mark.parametrize("episodes", [None, [1], [0, 2]], ids=str)
@pytest.mark.parametrize("return_uint8", [False, True], ids=["float", "uint8"])
def test_items_equal_those_of_the_stock_reader(
    root: Path, deltas: dict[str, list[int]] | None, episodes: list[int] | None, return_uint8: bool
) -> None:
    options = {"deltas": deltas, "episodes": episodes, "return_uint8": return_uint8}
    stock = opened(root, lerobot_compat.restore, **options)
    fast = opened(root, lerobot_compat.apply, **options)
    assert isinstance(fast.reader, FastDatasetReader)
    assert not isinstance(stock.reader, FastDatasetReader)
    assert len(fast) == len(stock) == sum(LENGTHS[e] for e in (episodes or range(3)))
    for index in range(len(stock)):
        assert_same(stock[index], fast[index])
    assert_same(stock[-1], fast[-1])
    with pytest.raises(IndexError):
        fast[len(fast)]


def test_image_transforms_see_the_same_images(root: Path) -> None:
    options = {"image_transforms": lambda image: image * 0.5, "deltas": {"action": [-1, 0]}}
    assert_same(opened(root, lerobot_compat.restore, **options)[3], opened(root, lerobot_compat.apply, **options)[3])


def test_marked_videos_are_not_decoded_and_everything_else_stays(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = {"image_transforms": lambda image: image * 0.5, "deltas": BOTH_ENDS}
    full, lean = (opened(root, lerobot_compat.apply, **options) for _ in range(2))
    lerobot_compat.skip_videos(lean.meta)
    expected = [full[index] for index in range(len(full))]
    monkeypatch.setattr(FastDatasetReader, "_query_videos", lambda *_: pytest.fail("a video was decoded"))
    for index, item in enumerate(expected):
        assert CAMERA in item
        assert_same(item, lean[index], without=(CAMERA,))


def test_of_a_marked_key_the_latest_step_is_read_and_everything_else_stays(root: Path) -> None:
    key = "observation.state"
    options = {"deltas": {key: [-2, -1, 0], "action": [-1, 0, 1]}}
    full, lean = (opened(root, lerobot_compat.apply, **options) for _ in range(2))
    lerobot_compat.read_latest_only(lean.meta, key)
    for index in range(len(full)):
        whole, short = full[index], lean[index]
        assert short[key].shape[0] == 1
        assert torch.equal(short[key], whole[key][-1:])
        assert short[f"{key}_is_pad"].tolist() == [False]
        others = {name: value for name, value in short.items() if not name.startswith(key)}
        assert_same(whole, others, without=(key, f"{key}_is_pad"))


def test_reader_and_mark_travel_into_data_loading_processes(root: Path) -> None:
    dataset = opened(root, lerobot_compat.apply, deltas={"action": [-1, 0, 1]})
    here = [dataset[index] for index in range(4)]
    # As in lerobot-train: the loader exists before the first item is asked for, the policy has marked the metadata.
    lerobot_compat.skip_videos(dataset.meta)
    loader = torch.utils.data.DataLoader(
        dataset, batch_size=None, sampler=range(4), num_workers=1, multiprocessing_context="spawn"
    )
    for one, other in zip(here, loader, strict=True):
        assert_same(one, other, without=(CAMERA,))


def test_numeric_columns_are_read_without_copying_the_dataset(root: Path) -> None:
    dataset = opened(root, lerobot_compat.apply)
    store = ColumnStore(dataset.hf_dataset)
    assert "observation.point_cloud" in store
    assert "complementary_info.note" not in store
    assert PICTURE not in store
    rows = store.rows("observation.point_cloud", [2, 0, 2])
    assert rows.shape == (3, 6, 3)
    assert torch.equal(rows[0], rows[2])
    rows[0] = 0.0
    assert store.rows("observation.point_cloud", [2]).any(), "an item is the reader's to give away: changing it is safe"


@pytest.mark.parametrize(
    "column",
    [
        pa.array(["a", "b"]),
        pa.array([1.0, None]),
        pa.array([[1.0], [2.0, 3.0, 4.0]]),
        pa.array([[1.0, None], [2.0, 3.0]]),
    ],
    ids=["text", "null", "ragged", "null inside"],
)
def test_what_is_no_plain_array_is_left_to_lerobot(column: pa.Array) -> None:
    assert columns.numeric_view(column) is None


def test_slices_of_arrow_memory_keep_their_rows() -> None:
    for kind in (pa.list_(pa.float32()), pa.list_(pa.float32(), 2), pa.large_list(pa.int64())):
        column = pa.array([[1, 2], [3, 4], [5, 6]], type=kind).slice(1, 2)
        view = columns.numeric_view(column)
        assert view is not None
        assert view.tolist() == [[3, 4], [5, 6]]


# Whose datasets, whose LeRobot ------------------------------------------------------------------------------------


def test_apply_is_idempotent_and_can_be_undone(root: Path) -> None:
    lerobot_compat.restore()
    assert lerobot_dataset.DatasetReader is DatasetReader
    assert lerobot_compat.apply()
    assert lerobot_compat.apply()
    assert type(opened(root, lambda: None).reader) is FastDatasetReader
    lerobot_compat.restore()
    assert lerobot_dataset.DatasetReader is DatasetReader


def test_other_datasets_keep_lerobots_own_reader(tmp_path: Path) -> None:
    features = {
        "observation.state": {"dtype": "float32", "shape": (4,), "names": None},
        "action": {"dtype": "float32", "shape": (3,), "names": ["x", "y", "z"]},
    }
    made = LeRobotDataset.create("local/other", fps=FPS, features=features, root=tmp_path / "other")
    for _ in range(3):
        frame = {key: np.ones(feature["shape"], np.float32) for key, feature in features.items()}
        made.add_frame({**frame, "task": "other"})
    made.save_episode()
    made.finalize()
    assert lerobot_compat.apply()
    read = LeRobotDataset("local/other", root=tmp_path / "other")
    assert type(read.reader) is DatasetReader
    assert type(made._ensure_reader()) is DatasetReader
    assert torch.equal(read[1]["action"], torch.ones(3))


@pytest.mark.parametrize(
    ("changed", "ours"),
    [
        ({}, True),
        ({"action": {"names": {"arm": list(schema.POSE_NAMES)}}}, True),
        ({"action": {"names": [f"joint_{k}.pos" for k in range(10)]}}, False),
        ({"action": {"names": None}}, False),
        ({"action": None}, False),
    ],
)
def test_ours_are_clouds_with_poses_as_actions(changed: dict[str, Any], ours: bool) -> None:
    features = schema.dataset_features() | changed
    assert lerobot_compat.is_ours(features) is ours
    assert not lerobot_compat.is_ours({key: value for key, value in features.items() if key != schema.POINT_CLOUD})


def changed_version(monkeypatch: pytest.MonkeyPatch) -> None:
    import lerobot

    monkeypatch.setattr(lerobot, "__version__", "0.6.2")


def changed_source(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lerobot_compat, "TESTED", {"0.6.1": "0" * 16})


@pytest.mark.parametrize("change", [changed_version, changed_source])
def test_a_lerobot_it_was_not_tested_with_keeps_its_own_reader_and_says_so_once(
    change: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    lerobot_compat.restore()
    change(monkeypatch)
    monkeypatch.setattr(lerobot_version, "_warned", set())
    with caplog.at_level(logging.WARNING):
        assert not lerobot_compat.apply()
        assert not lerobot_compat.apply()
    assert lerobot_dataset.DatasetReader is DatasetReader
    assert len([message for message in caplog.messages if "slower dataset reader stays" in message]) == 1


RENAMED = """
import inspect, sys
from lerobot.datasets import dataset_reader, lerobot_dataset
import lerobot.envs.utils as utils
private = [name for name in vars(utils) if name.startswith("_") and not name.startswith("__")]
for name in (*private, "FreezeAfterEpisodeEnd", "freeze_after_episode_end", "NEW_ROLLOUT_OPTION"):
    delattr(utils, name)
dataset_reader.Reader = dataset_reader.DatasetReader
del dataset_reader.DatasetReader, lerobot_dataset.DatasetReader
import lerobot_env_adamanip
from lerobot.configs.policies import PreTrainedConfig
from lerobot.envs.configs import EnvConfig
made = lerobot_env_adamanip.AdaManipSafeEnvConfig().create_envs(2, use_async_envs=True)["adamanip_safe"][0]
known = (*EnvConfig.get_known_choices(), *PreTrainedConfig.get_known_choices())
print(made.num_envs, "adamanip_safe" in known, "dp3_adaptive" in known)
"""


def test_a_lerobot_that_renamed_private_things_does_not_cost_the_plugin() -> None:
    done = subprocess.run([sys.executable, "-c", RENAMED], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.split()[-3:] == ["2", "True", "True"]


def test_measurement_reports_both_readers_and_leaves_things_as_they_were(root: Path) -> None:
    lerobot_compat.restore()
    measured = lerobot_compat.measure_reader(root, {"action": [-1, 0, 1]}, items=3)
    assert measured.keys() == {"stock_ms", "fast_ms", "speedup"}
    assert all(value > 0 for value in measured.values())
    assert lerobot_dataset.DatasetReader is DatasetReader


@pytest.mark.parametrize("module", ["lerobot_env_adamanip", "lerobot_policy_adamanip"])
@pytest.mark.parametrize("with_datasets", [True, False])
def test_only_the_plugin_and_only_where_datasets_are_read_brings_the_reader(module: str, with_datasets: bool) -> None:
    code = f"""
import sys
if {with_datasets}: import lerobot.datasets.lerobot_dataset
import {module}
from lerobot_policy_adamanip import DP3AdaptiveConfig
DP3AdaptiveConfig(device="cpu")
loaded = sys.modules.get("lerobot.datasets.lerobot_dataset")
print(loaded is not None, getattr(getattr(loaded, "DatasetReader", None), "__name__", "") == "make_reader")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-2:] == [str(with_datasets), str(with_datasets and module == "lerobot_env_adamanip")]


@pytest.mark.parametrize("kind", ["act", "diffusion"])
def test_rotation_and_gripper_stay_unscaled_by_lerobots_policies_where_that_is_asked_for(
    root: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """An environment variable, for LeRobot's commands make a policy's normaliser of the dataset's metadata."""
    draw = torch.randn(5, schema.ACTION_DIM)
    scaled = _normalised(root, kind, draw)
    monkeypatch.setenv(UNSCALED_POSES, "1")
    unscaled = _normalised(root, kind, draw)
    torch.testing.assert_close(unscaled[:, 3:], draw[:, 3:], rtol=0, atol=1e-6)
    assert torch.equal(unscaled[:, :3], scaled[:, :3])
    assert (scaled[:, 3:] - draw[:, 3:]).abs().min() > 0


def _normalised(root: Path, kind: str, actions: torch.Tensor) -> torch.Tensor:
    """Actions (B, 10) as a policy of LeRobot is given them in a training on the dataset."""
    lerobot_compat.restore()
    meta = opened(root, lerobot_compat.apply).meta
    config = make_policy_config(kind, device="cpu")
    features = dataset_to_policy_features(meta.features)
    config.output_features = {schema.ACTION: features[schema.ACTION]}
    config.input_features = {schema.STATE: features[schema.STATE]}
    before, _ = make_pre_post_processors(config, dataset_stats=meta.stats)
    batch = {schema.STATE: torch.zeros(len(actions), 4), schema.ACTION: actions.clone()}
    return torch.as_tensor(before(batch)[schema.ACTION])


def test_an_untested_lerobot_says_that_it_cannot_leave_poses_unscaled(monkeypatch: pytest.MonkeyPatch) -> None:
    lerobot_compat.restore()
    monkeypatch.setenv(UNSCALED_POSES, "1")
    monkeypatch.setattr(lerobot_compat, "TESTED", {"0.0.1": "no such source"})
    with pytest.raises(ConfigurationError, match=UNSCALED_POSES):
        lerobot_compat.apply()
