"""`checked_json`: what others wrote is taken as it should be, or refused with the field's name."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_adamanip.util import json_fields as checked
from lerobot_adamanip.util.errors import DatasetError

CHECK = checked.table(
    {
        "count": checked.integer(1, 9),
        "share": checked.number(0, 1),
        "yes": checked.flag,
        "kind": checked.choice(("a", "b")),
        "name": checked.text(r"[a-z]+", "lower-case letters"),
        "list": checked.listing(checked.integer(0, 9), 1, 3),
        "map": checked.mapping(checked.text("k.", "k."), checked.either(checked.flag, checked.number(0, 1)), 2),
        "maybe": checked.optional(checked.flag),
    }
)
GOOD: dict[str, Any] = {
    "count": 3, "share": 0.5, "yes": True, "kind": "a", "name": "abc", "list": [1, 2], "map": {"k1": True, "k2": 0.1},
    "maybe": None,
}  # fmt: skip


def test_what_is_right_comes_back() -> None:
    assert CHECK("it", GOOD) == {**GOOD, "list": (1, 2)}


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("count", 0), ("count", 10), ("count", True), ("count", 3.0), ("count", "3"), ("count", None),
        ("count", 10**400),
        ("share", 1.1), ("share", float("nan")), ("share", float("inf")), ("share", True), ("share", "0.5"),
        ("yes", 1), ("yes", "true"), ("kind", "c"), ("kind", ["a"]), ("kind", {}), ("name", ""), ("name", "a\n"),
        ("name", "../a"), ("list", []), ("list", [1] * 4), ("list", "12"), ("list", [[1]]), ("map", {"x": True}),
        ("map", {"k1": "yes"}), ("map", {"k1": True, "k2": True, "k3": True}), ("map", [1]), ("maybe", 0),
        ("unknown", 1),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_in_one_short_line(field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=field) as caught:
        CHECK("it", {**GOOD, field: value})
    assert len(str(caught.value)) < 300
    assert "\n" not in str(caught.value)


def test_what_is_missing_is_named() -> None:
    with pytest.raises(ValueError, match="lacks count, yes"):
        CHECK("it", {key: value for key, value in GOOD.items() if key not in ("count", "yes")})


@pytest.mark.parametrize(
    "text",
    ['{"a": NaN}', '{"a": Infinity}', '{"a": 1, "a": 2}', "[" * 100_000, "", "{", "\x00", '{"a": 1}x', b"\xff\xfe"],
)
def test_text_that_is_no_sound_json_is_refused(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 (whatever it says)
        checked.parse(text)


def test_what_is_too_large_is_not_even_read(tmp_path: Path) -> None:
    (tmp_path / "large").write_text(" " * 1000 + "{}")
    with pytest.raises(ValueError, match="bytes"):
        checked.read(tmp_path / "large", max_bytes=100)
    assert checked.read(tmp_path / "large", max_bytes=2000) == {}


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from([*GOOD, "x"]), inner, max_size=9),
)


@given(JSON)
def test_whatever_comes_it_is_taken_or_refused(content: Any) -> None:
    with contextlib.suppress(ValueError):
        assert set(CHECK("it", content)) == set(GOOD)


@pytest.mark.parametrize("deep", ["[" * 200_000, '{"a":' * 200_000])
def test_no_reader_of_others_files_breaks_on_deep_json(tmp_path: Path, deep: str) -> None:
    from safetensors.numpy import save_file

    from lerobot_adamanip.assets import AssetSource
    from lerobot_adamanip.datasets.dataset import Dataset
    from lerobot_adamanip.datasets.pose_statistics import leave_poses_unscaled
    from lerobot_adamanip.datasets.shards import read_record, read_shard

    for name, file in (("one", "meta.json"), ("two", "adamanip.json")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mobility.urdf").write_text("<robot/>")
        (tmp_path / name / file).write_text(deep)
    assert [report.usable for report in AssetSource(tmp_path).check("safe")] == [False, False]
    (tmp_path / "meta").mkdir()
    for name in ("stats", "info"):
        (tmp_path / "meta" / f"{name}.json").write_text(deep)
    with pytest.raises(ValueError, match="deep"):
        leave_poses_unscaled(tmp_path)
    with pytest.raises(DatasetError, match="deep"):
        Dataset(tmp_path)
    save_file({"a": np.zeros(1)}, tmp_path / "shard.safetensors", metadata={"record": deep})
    assert read_record(tmp_path / "shard.safetensors") is None
    with pytest.raises(DatasetError, match="recorded episode"):
        read_shard(tmp_path / "shard.safetensors")
