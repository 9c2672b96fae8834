"""What `adamanip stats` counts is what the rows say."""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from demos_helpers import another
from sound_demos import collect_sound

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.attempts import AttemptRecord, grouped_by_hidden_value
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.editing import merge
from lerobot_adamanip.datasets.stats import read_stats
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.report import Group
from lerobot_adamanip.util.errors import DatasetError


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Episodes of two categories, without pictures. Not to be written to."""
    root = tmp_path_factory.mktemp("contents") / "demos"
    return collect_sound(root, objects=("safe_000", "door_001"), episodes_per_object=5, observe_images=False)


def test_counts_are_those_of_the_rows(demos: Path) -> None:
    found = read_stats(demos)
    rows = pq.read_table(sorted((demos / "data").glob("*/*.parquet"))).to_pandas()
    lengths, failing = rows.groupby("episode_index").size(), rows[rows[schema.FAILED]]["episode_index"].nunique()
    overall = found.overall
    assert overall.episodes == len(lengths) == 10
    assert overall.key_frames == len(rows) - 10
    assert overall.tries == (rows[schema.TRIED] >= 0).sum()
    assert 0 < overall.failed_tries == rows[schema.FAILED].sum() < overall.tries
    assert (overall.recovered.count, overall.recovered.episodes) == (failing, failing)
    assert overall.success.count == 10
    assert found.lengths == dict(sorted(Counter(lengths - 1).items()))
    assert sum(count * episodes for count, episodes in found.failures.items()) == overall.failed_tries
    assert found.length_summary()["mean"] == pytest.approx(overall.key_frames / 10)
    assert (found.objects, found.rows) == (2, len(rows))
    assert found.late == sum(Dataset(demos).table["late"].to_pylist())


def test_groups_part_the_episodes(demos: Path) -> None:
    groups = read_stats(demos).groups
    table = Dataset(demos).table.to_pylist()
    locked = [json.loads(row["hidden_state"])["locked"] for row in table if row["object_id"] == "door_001"]
    assert groups[Group("category", "door")].episodes == groups[Group("category", "safe")].episodes == 5
    assert groups[Group("hidden", "door: locked")].episodes == sum(locked)
    assert groups[Group("hidden", "door: unlocked")].episodes == len(locked) - sum(locked)
    assert groups[Group("objects", "seen")].episodes == 10
    assert {group.by for group in groups} == {"all", "category", "objects", "hidden"}


def test_attempts_are_counted_where_they_are_told(demos: Path, tmp_path: Path) -> None:
    attempts = read_stats(demos).attempts
    lines = [json.loads(line) for line in (demos / "meta" / "attempts.jsonl").read_text().splitlines()]
    assert attempts is not None
    assert (attempts.kept.count, attempts.kept.episodes) == (10, len(lines))
    assert sum(tried for _, tried in attempts.hidden.values()) == len(lines)
    merge([demos, another(demos, tmp_path / "other")], tmp_path / "both")
    both = read_stats(tmp_path / "both")
    assert both.attempts is None
    assert both.overall.episodes == 20
    assert both.recovery is not None


def test_what_follows_a_failed_try_is_counted_as_evaluations_count_it(demos: Path) -> None:
    found = read_stats(demos).recovery
    assert found is not None
    assert found.repeated.episodes == read_stats(demos).overall.failed_tries  # the fake always tries once more
    assert found.repeated.count == found.repeated.episodes  # the same way, with the lock open


def test_without_columns_of_ours_tries_are_unknown_and_the_rest_is_counted_from_rows(
    demos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = Path(shutil.copytree(demos, tmp_path / "plain"))
    for name in ("collection.json", "attempts.jsonl"):
        (plain / "meta" / name).unlink()
    path = plain / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    table = pq.read_table(path)
    lerobots = ("episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index")
    pq.write_table(table.drop_columns([n for n in table.column_names if "/" not in n and n not in lerobots]), path)
    found, whole = read_stats(plain), read_stats(demos)
    unknown = {"labelled": 0, "tries": 0, "failed_tries": 0, "recovered": rate(0, 0)}
    assert found.overall == replace(whole.overall, **unknown)  # type: ignore[arg-type]
    assert (found.lengths, found.failures) == (whole.lengths, {})
    assert main(["stats", str(plain)]) == 0
    assert re.search(r"each +\| +- +\| +- +\| +- +\|", capsys.readouterr().out)
    assert (list(found.groups), found.objects, found.recovery) == ([Group("all", "all")], 0, None)


def test_the_command_prints(demos: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stats", str(demos)]) == 0
    out = capsys.readouterr().out
    assert "door: locked" in out
    assert "100 %" in out
    assert main(["stats", str(demos), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["groups"][0]["by"], told["groups"][0]["success"]["count"]) == ("all", 10)
    assert told["attempts"]["kept"]["count"] == 10
    assert told["key_frames"]["min"] >= 1


def test_no_dataset_and_half_of_one_are_one_clear_error(demos: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no dataset"):
        read_stats(tmp_path / "nothing")
    half = Path(shutil.copytree(demos, tmp_path / "half"))
    (half / "meta" / "attempts.jsonl").write_text('{"odd": 1}\n')
    with pytest.raises(DatasetError, match="invalid values"):
        read_stats(half)


# Attempts -----------------------------------------------------------------------------------------------------------


def attempt(kept: bool, hidden: dict[str, Any] | None, slot: int = 0) -> AttemptRecord:
    return AttemptRecord("safe_000", slot, 0, 1, hidden, kept, "success" if kept else "time limit", 9, False)


LISTED = [
    attempt(True, {"locked": True, "angle": 0.5}),
    attempt(False, {"locked": True, "angle": 1.5}),
    attempt(True, {"locked": False, "angle": 2.5}),
    attempt(False, None),
    replace(attempt(True, {"angle": 9.5}), object_id="door_000"),
]


def test_they_divide_by_each_hidden_value() -> None:
    groups = grouped_by_hidden_value(LISTED)
    table = {label: (sum(each.kept for each in group), len(group)) for label, group in groups.items()}
    assert table["safe: locked"] == (1, 2)
    assert table["safe: unlocked"] == (1, 1)
    assert table["safe: angle < 1.5"] == (1, 1)
    assert table["safe: angle >= 1.5"] == (1, 2)
    assert table["door: angle >= 9.5"] == (1, 1)  # ranges of categories differ, and so do their medians
    assert list(table.items())[-1] == ("safe: (no layout)", (0, 1))
    assert grouped_by_hidden_value([]) == {}
