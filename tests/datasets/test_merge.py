"""Datasets in one: nothing is lost, nothing else is changed, and LeRobot reads it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from demos_helpers import another
from lerobot.datasets.dataset_writer import DatasetWriter

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.filter import filter_episodes
from lerobot_adamanip.datasets.merge import merge
from lerobot_adamanip.datasets.reading import episode_table, load_check
from lerobot_adamanip.util.errors import AdaManipError


@pytest.fixture(scope="module")
def other(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Another dataset with the same rows: its metadata are written otherwise."""
    return another(finished, tmp_path_factory.mktemp("other") / "dataset")


@pytest.fixture(scope="module")
def merged(finished: Path, other: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two datasets of the same rows in one."""
    out = tmp_path_factory.mktemp("merged") / "both"
    assert merge([finished, other], out).episodes == 2 * load_check(finished)["total_episodes"]
    return out


def _rows(root: Path) -> dict[str, np.ndarray]:
    table = pq.read_table(sorted((root / "data").glob("*/*.parquet"))).sort_by("index")
    return {name: np.asarray(table[name].to_pylist()) for name in table.column_names}


def test_rows_are_those_of_the_parts_in_order(finished: Path, merged: Path) -> None:
    part, whole = _rows(finished), _rows(merged)
    count, episodes = len(part["index"]), load_check(finished)["total_episodes"]
    assert part[schema.POINT_CLOUD].ndim == 2
    assert set(whole) == set(part)
    for name, values in part.items():
        shift = {"index": count, "episode_index": episodes}.get(name, 0)
        np.testing.assert_array_equal(whole[name][:count], values, err_msg=name)
        np.testing.assert_array_equal(whole[name][count:], values + shift if shift else values, err_msg=name)


def test_columns_of_episodes_are_kept(finished: Path, merged: Path) -> None:
    part, whole = episode_table(finished).to_pylist(), episode_table(merged).to_pylist()
    kept = ("object_id", "seed", "hidden_state", "success", "start", "fingerprint")
    assert [[row[name] for name in kept] for row in whole] == 2 * [[row[name] for name in kept] for row in part]


def test_what_cannot_be_merged_is_one_clear_error_and_leaves_nothing(finished: Path, tmp_path: Path) -> None:
    for parts, out, said in (
        ([finished], tmp_path / "new", "nothing to merge"),
        ([finished, tmp_path / "none"], tmp_path / "new", "none"),
        ([finished, finished], tmp_path / "new", "share episodes"),
        ([finished, finished.parent / ".." / finished.parent.name / finished.name], tmp_path / "new", "share episodes"),
    ):
        with pytest.raises(AdaManipError, match=said):
            merge(parts, out)
    assert list(tmp_path.iterdir()) == []


def test_parts_of_different_columns_are_refused(finished: Path, unpictured: Path, tmp_path: Path) -> None:
    with pytest.raises(AdaManipError, match=r"different features(.|\n)*images\.front(.|\n)*adamanip render"):
        merge([finished, unpictured], tmp_path / "new")
    assert list(tmp_path.iterdir()) == []


def test_a_dataset_and_its_part_are_refused_whatever_else_is_merged(
    unpictured: Path, tmp_path: Path, finished: Path
) -> None:
    filter_episodes(unpictured, ["episode_index=1:3"], tmp_path / "part")
    third = another(unpictured, tmp_path / "third")
    for parts in ([unpictured, tmp_path / "part"], [third, tmp_path / "part", unpictured]):
        with pytest.raises(AdaManipError, match=r"share episodes(.|\n)*2 of them: 1, 2 "):
            merge(parts, tmp_path / "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["part", "third"]


def test_a_lerobot_with_another_writer_is_refused(
    finished: Path, other: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(DatasetWriter, "_save_episode_video")
    with pytest.raises(AdaManipError, match="writes datasets otherwise"):
        merge([finished, other], tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_the_command_reports(finished: Path, other: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["merge", str(finished), str(other), "--out", str(tmp_path / "new"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    count = 2 * load_check(finished)["total_episodes"]
    assert told["episodes"] == load_check(tmp_path / "new")["total_episodes"] == count
    assert (told["parts_of_one"], told["whole"], len(told["fingerprints"])) == (False, False, 1)
