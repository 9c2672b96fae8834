"""Which episodes a condition chooses, and how a split shares them out."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.conditions import choose, counted_labels, episode_values
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.editing import assign
from lerobot_adamanip.util.errors import AdaManipError

EPISODES: list[dict[str, Any]] = [
    {"failed_tries": 0, "success": True, "object_id": "safe_000", "hidden.range": 1.25, "note": None, "code": "7"},
    {"failed_tries": 2, "success": False, "object_id": "safe_001", "hidden.range": 1.5, "note": "x", "code": "07"},
    {"failed_tries": 9, "success": True, "object_id": "door_n002", "hidden.range": 2.0, "note": "y z", "code": "a"},
]
CHOSEN = {
    "failed_tries>=1": [1, 2], "failed_tries > 2": [2], "failed_tries<1": [0], "failed_tries<=2": [0, 1],
    "failed_tries<=1.5": [0], "failed_tries=0,9": [0, 2], "failed_tries=0:2,9": [0, 2], "failed_tries!=0:2": [1, 2],
    "success=true": [0, 2], "success!=TRUE": [1], "success == false": [1], "object_id=safe_000,door_n002": [0, 2],
    "object_id!=safe_000": [1, 2], "hidden.range>1.3": [1, 2], "hidden.range=1.5": [1], "note=x": [1],
    "note!=x": [2], "note=y z": [2], "code=7": [0],
}  # fmt: skip
REFUSED = {
    "": "wrong form", "failed_tries": "wrong form", "failed_tries>=": "wrong form",
    "__import__('os').system('x')=1": "wrong form",
    "failed_trys>1": "failed_tries, hidden.range, note, object_id, success", "failed_tries>x": "0 to 9",
    "failed_tries=__class__": "0 to 9", "success=maybe": "true or false", "success>false": "= or !=",
    "object_id>safe": "= or !=", "failed_tries>1,2": "0 to 9", "object_id=safe_007": "safe_000, safe_001",
}  # fmt: skip
"""Condition -> what its error names."""


def table_of(episodes: list[dict[str, Any]]) -> pd.DataFrame:
    table = pd.DataFrame(episodes, dtype=object)
    return table.where(table.notna(), None)


@pytest.mark.parametrize("text", CHOSEN)
def test_conditions(text: str) -> None:
    assert choose([text], table_of(EPISODES)) == CHOSEN[text]


MIXED: list[dict[str, Any]] = [
    {"mode": True, "side": "left", "share": 1}, {"mode": 1, "side": 2, "share": 0.5},
    {"mode": 0, "side": True, "share": 2}, {"mode": False, "side": "2", "share": 1.0},
]  # fmt: skip
"""Values as merged datasets have them: one value stored in two types."""


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        ("mode=1", [0, 1]), ("mode=true", [0, 1]), ("mode!=TRUE", [2, 3]), ("mode<1", [2, 3]), ("mode=0,false", [2, 3]),
        ("side=2", [1, 3]), ("side=true", [2]), ("side!=left", [1, 2, 3]), ("share=1", [0, 3]), ("share<1", [1]),
    ],
)  # fmt: skip
def test_conditions_hold_on_columns_of_several_types(text: str, chosen: list[int]) -> None:
    assert choose([text], table_of(MIXED)) == chosen


def test_columns_of_several_types_are_split() -> None:
    assert assign(table_of(MIXED), None, by="mode", seed=0) == {"true": [0, 1], "0": [2, 3]}
    assert assign(table_of(MIXED), None, by="side", seed=0) == {"true": [2], "2": [1, 3], "left": [0]}


@pytest.mark.parametrize("text", REFUSED)
def test_what_chooses_nothing_is_one_clear_error(text: str) -> None:
    with pytest.raises(AdaManipError) as error:
        choose([text], table_of(EPISODES))
    assert REFUSED[text] in str(error.value)


def test_what_is_known_of_an_episode(finished: Path) -> None:
    dataset = Dataset(finished)
    table, labels = episode_values(dataset), counted_labels(dataset)
    rows = pq.read_table(sorted((finished / "data").glob("*/*.parquet"))).to_pandas()
    for number, each in enumerate(table.to_dict("records")):
        mine = rows[rows["episode_index"] == number]
        assert each["key_frames"] == len(mine) - 1
        failed = mine.loc[mine[schema.TRIED] >= 0, schema.FAILED].tolist()
        counts = (each["tries"], each["failed_tries"], each["success"])
        assert counts == (len(failed), sum(failed), mine[schema.SUCCESS].any())
        assert (len(mine) - 1, each["success"]) == tuple(labels.loc[number, ["key_frames", "success"]])
        assert (each["category"], each["object_split"], each["task"]) == ("safe", "seen", "open the fake")
    assert {"tries", "failed_tries", "success", "late", "expert", "slot", "seed", "hidden.locked"} <= set(table)
    assert not {"camera", "versions", "hidden_state", "data/file_index"} & set(table)
    assert max(table["recoveries"]) == 1


@pytest.mark.parametrize(
    ("tries", "recoveries"),
    [
        ([[1, 1, True], [1, -1, False]], 1),  # both in one row
        ([[0, 1, False], [1, 1, True], [1, 1, True], [1, -1, False], [0, 1, True]], 1),
        ([[1, 1, True], [1, -1, False], [0, 1, True], [0, 1, False]], 2),
        ([], 0),
        (None, None),
    ],
)
def test_recoveries_are_of_tries_not_of_rows(unpictured: Path, tmp_path: Path, tries: Any, recoveries: Any) -> None:
    root = Path(shutil.copytree(unpictured, tmp_path / "copy"))
    (path,) = (root / "meta" / "episodes").glob("*/*.parquet")
    table = pq.read_table(path)
    records = [json.loads(text) for text in table["episode_record"].to_pylist()]
    records = [{name: value for name, value in each.items() if name != "try_sequence"} for each in records]
    if tries is not None:
        records[2]["try_sequence"] = tries
    at = table.column_names.index("episode_record")
    pq.write_table(table.set_column(at, table.field(at), pa.array(map(json.dumps, records))), path)
    values = episode_values(Dataset(root))
    if recoveries is None:
        with pytest.raises(AdaManipError, match="lack this column"):
            choose(["recoveries>=0"], values)
    else:
        assert values["recoveries"].tolist() == [None, None, recoveries, None, None, None]


MANY: list[dict[str, Any]] = [
    {"episode_index": n, "object_id": f"safe_{n % 7:03d}", "success": n % 3 > 0} for n in range(50)
]


@given(
    shares=st.lists(st.integers(1, 20), min_size=2, max_size=5),
    by=st.sampled_from(["episode_index", "object_id"]),
    seed=st.integers(0, 99),
)
def test_everything_goes_to_one_part_and_values_stay_together(shares: list[int], by: str, seed: int) -> None:
    named = {f"part{number}": share / sum(shares) for number, share in enumerate(shares)}
    parts = assign(table_of(MANY), named, by=by, seed=seed)
    assert parts == assign(table_of(MANY), named, by=by, seed=seed)
    assert list(parts) == list(named)
    assert sorted(index for mine in parts.values() for index in mine) == list(range(50))
    values: list[set[Any]] = [{MANY[index][by] for index in mine} for mine in parts.values()]
    assert all(values)
    total = len({each[by] for each in MANY})
    assert sum(map(len, values)) == total
    for mine, share in zip(values, named.values(), strict=True):
        assert len(mine) == 1 or abs(len(mine) - share * total) < 1 + len(shares)


def test_shares_are_kept_and_seeds_differ() -> None:
    parts = [assign(table_of(MANY), {"a": 0.8, "b": 0.2}, by="episode_index", seed=seed) for seed in range(3)]
    assert [(len(each["a"]), len(each["b"])) for each in parts] == [(40, 10)] * 3
    assert len({tuple(each["b"]) for each in parts}) == 3
