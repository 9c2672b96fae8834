"""`adamanip check` of datasets at control rate: sound ones are clean, and each damage is named and placed."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import check_damages as to
import pytest
from check_damages import DATA, Damage
from demos_helpers import InThisProcess
from dense_episodes import FULL, collect_dense

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import image_column
from lerobot_adamanip.contract.control import ACTION_NAMES
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.check.features import OF_LEROBOT, check_features, contract_of
from lerobot_adamanip.datasets.check.findings import Report
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.util import jobs

TRY, LAST = "the row of a try", "the last row"
DELTA, POSE, JOINT = ACTION_NAMES


@pytest.fixture(scope="module")
def dense(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """Kind of action -> a sound dataset; ``ee_pose`` has clouds, effort and the full state."""
    root = tmp_path_factory.mktemp("dense")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs, "WorkerPool", InThisProcess)
        return {
            kind: collect_dense(root / kind, action=kind, **(FULL if kind == POSE else {})) for kind in ACTION_NAMES
        }


@pytest.mark.parametrize("kind", ACTION_NAMES)
def test_a_sound_dataset_is_clean(kind: str, dense: Mapping[str, Path]) -> None:
    report = check(dense[kind])
    assert report.findings == []
    assert report.episodes == 4


def column(key: str, place: int, value: float, frame: int = 1) -> object:
    return to.edit_cell(key, 0, frame, to.at((place,), value))


DAMAGES = [
    (DELTA, Damage("too large a step", column(schema.ACTION, 2, 1.2), [("limits", DATA, 0, 1)])),
    (DELTA, Damage("gripper beyond", column(schema.ACTION, 6, -1.5), [("limits", DATA, 0, 1)])),
    (DELTA, Damage("executed beyond, as policies send", column(schema.EXECUTED, 0, 3.0),
                   [("episode-statistics", DATA, 0, None)])),
    (POSE, Damage("no rotation", column(schema.ACTION, 3, 0.5), [("rotation", DATA, 0, 1)])),
    (POSE, Damage("state of no rotation", column(schema.STATE, 4, 0.5), [("rotation", DATA, 0, 1)])),
    (POSE, Damage("point far away", column(schema.POINT_CLOUD, 0, 9.0), [("workspace", DATA, 0, 1)])),
    (JOINT, Damage("joint beyond its stop", column(schema.ACTION, 3, 0.2), [("limits", DATA, 0, 1)])),
    (JOINT, Damage("not finite", column(schema.ACTION, 3, float("nan")), [("not-finite", DATA, 0, 1)])),
    (DELTA, Damage("fingers beyond", column(schema.STATE, 7, 0.08), [("limits", DATA, 0, 1)])),
    (DELTA, Damage("turned twice around", column(schema.STATE, 4, 7.0), [("limits", DATA, 0, 1)])),
    (DELTA, Damage("key frame of no rotation", column(schema.KEY_FRAME, 3, 0.5),
                   [("rotation", DATA, 0, 1), ("label", DATA, 0, 1)])),
    (DELTA, Damage("outcome of no code", to.edit_cell(schema.OUTCOME, 0, 1, lambda _: 7), [("label", DATA, 0, 1)])),
    (DELTA, Damage("direction of no code", to.edit_cell(schema.DIRECTION, 0, 1, lambda _: 3), [("label", DATA, 0, 1)])),
    (DELTA, Damage("phase changes early", to.edit_cell(schema.PHASE, 0, 1, lambda phase: phase + 1),
                   [("label", DATA, 0, 1)])),
    (DELTA, Damage("key frame changes early", column(schema.KEY_FRAME, 0, 0.123), [("label", DATA, 0, 1)])),
    (DELTA, Damage("try counted too early", to.edit_cell(schema.TRIAL, 0, 1, lambda _: 1),
                   [("label", DATA, 0, 1), ("label", DATA, 0, 2)])),
    (DELTA, Damage("direction without a try", to.edit_cell(schema.DIRECTION, 0, 1, lambda _: 1),
                   [("label", DATA, 0, 1)])),
    (DELTA, Damage("failed without a try", to.edit_cell(schema.FAILED, 0, 1, lambda _: True), [("label", DATA, 0, 1)])),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "damage"), [pytest.param(kind, each, id=each.name) for kind, each in DAMAGES])
def test_damage_is_named_and_placed(kind: str, damage: Damage, dense: Mapping[str, Path], tmp_path: Path) -> None:
    root = tmp_path / "damaged"
    shutil.copytree(dense[kind], root)
    damage.do(root)
    places = {(each.kind, each.file, each.episode, each.frame) for each in check(root).findings}
    assert places == set(damage.found)


def test_pictures_may_be_of_any_camera() -> None:
    assert contract_of(schema.dataset_features(64, 32, cameras=["wrist"]))[image_column("wrist")]["shape"] == (
        32,
        32,
        3,
    )


@pytest.mark.parametrize("key", OF_LEROBOT)
def test_a_missing_column_of_lerobot_is_named(key: str, dense: Mapping[str, Path]) -> None:
    features = {name: feature for name, feature in Dataset(dense[DELTA]).features.items() if name != key}
    report = Report()
    check_features(features, report, collected=True)
    assert [finding.message for finding in report.findings] == [f"no column {key}"]


def test_the_final_observation_ends_no_key_frame(dense: Mapping[str, Path], tmp_path: Path) -> None:
    root = tmp_path / "damaged"
    shutil.copytree(dense[DELTA], root)
    last = next(path for path in [root / DATA])
    import pyarrow.parquet as pq

    numbers = pq.read_table(last, columns=["episode_index"])["episode_index"].to_pylist()
    frame = numbers.count(0) - 1
    to.edit_cell(schema.OUTCOME, 0, frame, lambda _: 0)(root)
    (found,) = check(root).findings
    assert (found.kind, found.episode, found.frame) == ("label", 0, frame)
