"""Parts of datasets: nothing is changed but indices, and all parts together are the dataset again."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from demos_helpers import same_content
from hypothesis import given
from hypothesis import strategies as st

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets import cutting
from lerobot_adamanip.datasets.conditions import Facts, parse_condition
from lerobot_adamanip.datasets.episode_facts import episode_facts, recoveries
from lerobot_adamanip.datasets.filter import filter_episodes
from lerobot_adamanip.datasets.merge import merge
from lerobot_adamanip.datasets.reading import episode_table, load_check
from lerobot_adamanip.datasets.selection import read_selection, selection_path
from lerobot_adamanip.datasets.source import Source
from lerobot_adamanip.datasets.split import assign, split_episodes
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_adamanip.util.video import write_video

Refuses = Callable[[type, Callable[[], Any]], str]
HALVES = {"one": 0.5, "other": 0.5}
NUMBERED = ("episode_index", "index")


@pytest.fixture(scope="module", params=["pictures", "no pictures"])
def whole(request: pytest.FixtureRequest, finished: Path, unpictured: Path) -> Path:
    """A dataset. Not to be written to."""
    return finished if request.param == "pictures" else unpictured


def rows(root: Path) -> dict[str, np.ndarray]:
    table = pq.read_table(sorted((root / "data").glob("*/*.parquet"))).sort_by("index")
    return {name: np.asarray(table[name].to_pylist()) for name in table.column_names}


def same_statistics(first: Path, second: Path) -> None:
    """Asserts equal statistics, to what is lost when single precision is stored as text."""
    one, other = (json.loads((root / "meta" / "stats.json").read_text()) for root in (first, second))
    assert list(one) == list(other)
    for key, values in one.items():
        assert list(values) == list(other[key])
        for name, value in values.items():
            np.testing.assert_allclose(other[key][name], value, rtol=1e-6, atol=1e-9, err_msg=f"{key} {name}")


def same(first: Path, second: Path) -> None:
    """Asserts that two datasets are equal: rows, frames, episodes, statistics, and all that tells of them."""
    for name in sorted(path.relative_to(first) for path in first.rglob("*") if path.is_file()):
        if str(name) not in ("README.md", "meta/stats.json"):
            assert (second / name).exists(), name
    for name in ("meta/attempts.jsonl", "meta/tasks.parquet"):
        assert (first / name).read_bytes() == (second / name).read_bytes(), name
    same_statistics(first, second)
    stored = (second / "meta" / "stats.json").read_bytes()
    try:  # compared above
        (second / "meta" / "stats.json").write_bytes((first / "meta" / "stats.json").read_bytes())
        same_content(first, second) if (first / "videos").exists() else same_tables(first, second)
        for video in first.rglob("*.mp4"):
            assert video.read_bytes() == (second / video.relative_to(first)).read_bytes()
    finally:
        (second / "meta" / "stats.json").write_bytes(stored)


def same_tables(first: Path, second: Path) -> None:
    for name in sorted(path.relative_to(first) for path in first.rglob("*.parquet")):
        assert pq.read_table(first / name).equals(pq.read_table(second / name)), name


@pytest.mark.parametrize("by", ["episode_index", "object_id", "hidden.locked"])
def test_all_parts_together_are_the_dataset_again(
    whole: Path, by: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cutting, "_encoded_anew", lambda *_: pytest.fail("pictures were encoded again"))
    parts = split_episodes(whole, tmp_path / "parts", HALVES if by != "hidden.locked" else None, by=by, seed=1)
    assert sorted(index for mine in parts.values() for index in mine) == list(range(6))
    assert len(parts) == 2
    places = [tmp_path / "parts" / name for name in parts]
    for order in (places, places[::-1]):
        shutil.rmtree(tmp_path / "again", ignore_errors=True)
        merged = merge(order, tmp_path / "again")
        assert (merged.episodes, merged.parts_of_one, merged.whole) == (6, True, True)
        same(whole, tmp_path / "again")
        assert not selection_path(tmp_path / "again").exists()


def test_parts_of_parts_find_together(unpictured: Path, tmp_path: Path) -> None:
    split_episodes(unpictured, tmp_path / "parts", HALVES, seed=4)
    filter_episodes(tmp_path / "parts" / "one", ["episode_index=1:3"], tmp_path / "end")
    filter_episodes(tmp_path / "parts" / "one", ["episode_index=0"], tmp_path / "begin")
    half = merge([tmp_path / "end", tmp_path / "begin"], tmp_path / "half")
    assert (half.parts_of_one, half.whole) == (True, False)
    same(tmp_path / "parts" / "one", tmp_path / "half")
    found, wanted = (json.loads(selection_path(tmp_path / name).read_text()) for name in ("half", "parts/one"))
    assert [command.split()[:2] for command in wanted.pop("made_with")] == [["adamanip", "split"]]
    assert found == {**wanted, "made_with": []}
    merge([tmp_path / "parts" / "other", tmp_path / "end", tmp_path / "begin"], tmp_path / "again")
    same(unpictured, tmp_path / "again")


def test_a_filtered_dataset_holds_those_episodes_as_they_were(whole: Path, tmp_path: Path) -> None:
    chosen = filter_episodes(whole, ["hidden.locked=true"], tmp_path / "locked")
    locked = [json.loads(text)["locked"] for text in episode_table(whole)["hidden_state"].to_pylist()]
    assert chosen == [index for index, value in enumerate(locked) if value]
    assert 0 < len(chosen) < 6
    before, after = rows(whole), rows(tmp_path / "locked")
    kept = np.isin(before["episode_index"], chosen)
    for name, values in before.items():
        if name not in NUMBERED:
            np.testing.assert_array_equal(after[name], values[kept], err_msg=name)
    np.testing.assert_array_equal(after["index"], np.arange(kept.sum()))
    renumbered = [chosen.index(index) for index in before["episode_index"][kept]]
    np.testing.assert_array_equal(after["episode_index"], renumbered)


@pytest.mark.parametrize("rows_each", [1000, 5])
def test_rows_are_found_however_a_file_is_laid_out(unpictured: Path, tmp_path: Path, rows_each: int) -> None:
    shutil.copytree(unpictured, tmp_path / "copy")
    (path,) = (tmp_path / "copy" / "data").rglob("*.parquet")
    pq.write_table(pq.read_table(path), path, row_group_size=rows_each)
    for root in (unpictured, tmp_path / "copy"):
        filter_episodes(root, ["episode_index=1,2,4"], tmp_path / f"part of {root.name}")
    same_tables(tmp_path / "part of dataset", tmp_path / "part of copy")


def test_columns_of_episodes_cameras_and_manifest_stay(whole: Path, tmp_path: Path) -> None:
    filter_episodes(whole, ["episode_index=2,4"], tmp_path / "part")
    before, after = (episode_table(root) for root in (whole, tmp_path / "part"))
    assert before.column_names == after.column_names
    own = [name for name in Source.open(whole).own_columns.column_names if name != "episode_index"]
    assert {"object_id", "seed", "hidden_state", "start", "camera", "fingerprint"} <= set(own)
    for name in own:
        assert after[name].type == before[name].type
        assert after[name].to_pylist() == [before[name][index].as_py() for index in (2, 4)], name
    for name in ("collection.json", "attempts.jsonl"):
        assert (tmp_path / "part" / "meta" / name).read_bytes() == (whole / "meta" / name).read_bytes()
    (cameras,) = json.loads((tmp_path / "part" / "meta" / "cameras.json").read_text()).values()
    assert cameras["per_episode"] == ["cam_in_base"]


def test_what_differs_between_merged_datasets_is_known_where_they_agree(finished: Path, tmp_path: Path) -> None:
    shutil.copytree(finished, tmp_path / "copy")
    info = load_check(tmp_path / "copy")
    info["features"][schema.FRONT_IMAGE]["info"]["video.crf"] = 30
    (tmp_path / "copy" / "meta" / "info.json").write_text(json.dumps(info))
    merge([finished, tmp_path / "copy"], tmp_path / "both")
    old, new = (load_check(root)["features"][schema.FRONT_IMAGE]["info"] for root in (finished, tmp_path / "both"))
    assert {name for name in old if name not in new} == {"video.crf"}
    assert {name: old[name] for name in new} == new


# Videos -----------------------------------------------------------------------------------------------------------


def test_packets_are_copied_and_encoded_anew_only_where_they_must(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = Source.open(finished)
    (file,) = (finished / "videos").rglob("*.mp4")
    first, length = source.row(2)["dataset_from_index"], source.row(2)["length"]
    assert cutting._copied(file, tmp_path / "cut.mp4", (first, first + length), schema.FPS) == length
    ramp = (np.full((64, 64, 3), 20 * number, np.uint8) for number in range(10))
    write_video(tmp_path / "one_key_frame.mp4", ramp, schema.FPS)
    assert cutting._copied(tmp_path / "one_key_frame.mp4", tmp_path / "other.mp4", (3, 7), schema.FPS) is None
    seen = frames(file)
    np.testing.assert_array_equal(frames(tmp_path / "cut.mp4"), seen[first : first + length])
    monkeypatch.setattr(cutting, "_copied", lambda *_: None)
    feature = source.info["features"][schema.FRONT_IMAGE]
    (tmp_path / "anew.mp4").write_bytes(
        cutting.cut_episode(finished, schema.FRONT_IMAGE, feature, source.row(2), schema.FPS)
    )
    difference = np.abs(frames(tmp_path / "anew.mp4").astype(int) - seen[first : first + length])
    assert difference.max() < 12


def frames(path: Path) -> np.ndarray:
    import av

    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


def test_a_video_that_is_too_short_is_named(finished: Path, tmp_path: Path) -> None:
    shutil.copytree(finished, tmp_path / "copy")
    (file,) = (tmp_path / "copy" / "videos").rglob("*.mp4")
    cutting._copied(file, tmp_path / "short.mp4", (0, 10), schema.FPS)
    shutil.move(tmp_path / "short.mp4", file)
    with pytest.raises(AdaManipError, match="does not fit its episode"):
        filter_episodes(tmp_path / "copy", [], tmp_path / "part")
    assert not (tmp_path / "part").exists()


# Conditions -------------------------------------------------------------------------------------------------------

FACTS: list[Facts] = [
    {"failed_tries": 0, "success": True, "object_id": "safe_000", "hidden.range": 1.25, "note": None, "code": "7"},
    {"failed_tries": 2, "success": False, "object_id": "safe_001", "hidden.range": 1.5, "note": "x", "code": "07"},
    {"failed_tries": 9, "success": True, "object_id": "door_n002", "hidden.range": 2.0, "note": "y z", "code": "a"},
]


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        ("failed_tries>=1", [1, 2]),
        ("failed_tries > 2", [2]),
        ("failed_tries<1", [0]),
        ("failed_tries<=2", [0, 1]),
        ("failed_tries<=1.5", [0]),
        ("failed_tries=0,9", [0, 2]),
        ("failed_tries=0:2,9", [0, 2]),
        ("failed_tries!=0:2", [1, 2]),
        ("success=true", [0, 2]),
        ("success!=TRUE", [1]),
        ("success == false", [1]),
        ("object_id=safe_000,door_n002", [0, 2]),
        ("object_id!=safe_000", [1, 2]),
        ("hidden.range>1.3", [1, 2]),
        ("hidden.range=1.5", [1]),
        ("note=x", [1]),
        ("note!=x", [2]),
        ("note=y z", [2]),
        ("code=7", [0]),
    ],
)
def test_conditions(text: str, chosen: list[int]) -> None:
    condition = parse_condition(text, FACTS)
    assert [index for index, each in enumerate(FACTS) if condition.holds(each)] == chosen


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no condition"),
        ("failed_tries", "no condition"),
        ("failed_tries>=", "no condition"),
        ("__import__('os').system('x')=1", "no condition"),
        ("failed_trys>1", "failed_tries, hidden.range, note, object_id, success"),
        ("failed_tries>x", "0 to 9"),
        ("failed_tries=__class__", "0 to 9"),
        ("success=maybe", "true or false"),
        ("success>false", "= or !="),
        ("object_id>safe", "= or !="),
        ("failed_tries>1,2", "0 to 9"),
    ],
)
def test_what_is_no_condition_is_one_clear_error(text: str, said: str) -> None:
    with pytest.raises(AdaManipError) as error:
        parse_condition(text, FACTS)
    assert said in str(error.value)


def test_no_episode_is_an_error_that_tells_what_there_is(finished: Path, tmp_path: Path) -> None:
    with pytest.raises(AdaManipError, match=r"No episode(.|\n)*object_id: safe_000, safe_001"):
        filter_episodes(finished, ["object_id=safe_007"], tmp_path / "part")
    assert list(tmp_path.iterdir()) == []


def test_what_is_known_of_an_episode(finished: Path) -> None:
    source = Source.open(finished)
    facts = episode_facts(source)
    table = rows(finished)
    for number, each in enumerate(facts):
        mine = table["episode_index"] == number
        assert each["key_frames"] == mine.sum() - 1
        tried = table[schema.TRIED][mine] >= 0
        assert each["recoveries"] == recoveries(table[schema.FAILED][mine][tried].tolist())
        assert (each["category"], each["object_split"]) == ("safe", "seen")
        assert each["task"] == "open the fake"
    assert {"tries", "failed_tries", "success", "late", "expert", "slot", "seed", "hidden.locked"} <= set(facts[0])
    assert not {"camera", "versions", "hidden_state", "data/file_index"} & set(facts[0])
    assert max(each["recoveries"] or 0 for each in facts) == 1


# Parts ------------------------------------------------------------------------------------------------------------

MANY: list[Facts] = [{"episode_index": n, "object_id": f"safe_{n % 7:03d}", "success": n % 3 > 0} for n in range(50)]


@given(
    shares=st.lists(st.integers(1, 20), min_size=2, max_size=5),
    by=st.sampled_from(["episode_index", "object_id"]),
    seed=st.integers(0, 99),
)
def test_everything_goes_to_one_part_and_values_stay_together(shares: list[int], by: str, seed: int) -> None:
    named = {f"part{number}": share / sum(shares) for number, share in enumerate(shares)}
    parts = assign(MANY, named, by=by, seed=seed)
    assert parts == assign(MANY, named, by=by, seed=seed)
    assert list(parts) == list(named)
    assert sorted(index for mine in parts.values() for index in mine) == list(range(50))
    values = [{MANY[index][by] for index in mine} for mine in parts.values()]
    assert all(values)
    assert sum(map(len, values)) == len({each[by] for each in MANY})
    total = sum(map(len, values))
    for mine, share in zip(values, named.values(), strict=True):
        assert len(mine) == 1 or abs(len(mine) - share * total) < 1 + len(shares)


def test_shares_are_kept_and_seeds_differ() -> None:
    parts = [assign(MANY, {"a": 0.8, "b": 0.2}, by="episode_index", seed=seed) for seed in range(3)]
    assert [(len(each["a"]), len(each["b"])) for each in parts] == [(40, 10)] * 3
    assert len({tuple(each["b"]) for each in parts}) == 3


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--parts", "a=0.5,b=0.6"], "no parts of a whole"),
        (["--parts", "a=1"], "no parts of a whole"),
        (["--parts", "a=0.5,a=0.5"], "Wrong parts"),
        (["--parts", "../a=0.5,b=0.5"], "Wrong parts"),
        (["--parts", "a=half,b=0.5"], "Wrong parts"),
        ([], "Wrong parts"),
        (["--by", "nothing"], "no such|has such"),
        (["--parts", "a=0.2,b=0.3,c=0.5", "--by", "object_id"], "not enough to part"),
        (["--by", "task"], "name of a folder"),
    ],
)
def test_what_cannot_be_parted_is_one_clear_error(
    unpictured: Path, tmp_path: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    import re

    assert main(["split", str(unpictured), "--out", str(tmp_path / "parts"), *options]) == 2
    error = capsys.readouterr().err
    assert re.search(said, error)
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_parts_that_share_episodes_are_refused(unpictured: Path, tmp_path: Path) -> None:
    for name, condition in (("low", "episode_index=0:4"), ("high", "episode_index=2:6")):
        filter_episodes(unpictured, [condition], tmp_path / name)
    with pytest.raises(AdaManipError, match=r"share episodes(.|\n)*2 of them: 2, 3"):
        merge([tmp_path / "low", tmp_path / "high"], tmp_path / "both")
    with pytest.raises(AdaManipError, match="share episodes"):
        merge([tmp_path / "low", unpictured], tmp_path / "both")
    assert not (tmp_path / "both").exists()


@pytest.mark.parametrize(
    "content", ["no json", "{}", '{"format": 1, "source": "%s", "source_episodes": 6, "episodes": [0, 9]}' % ("0" * 32)]
)
def test_a_selection_that_cannot_be_is_one_clear_error(unpictured: Path, tmp_path: Path, content: str) -> None:
    filter_episodes(unpictured, ["episode_index=0:2"], tmp_path / "part")
    selection_path(tmp_path / "part").write_text(content)
    with pytest.raises(AdaManipError, match="which episodes"):
        read_selection(tmp_path / "part", 2)


def test_damage_is_named_and_leaves_nothing(unpictured: Path, tmp_path: Path) -> None:
    shutil.copytree(unpictured, tmp_path / "copy")
    (path,) = (tmp_path / "copy" / "data").rglob("*.parquet")
    table = pq.read_table(path)
    swapped = table["episode_index"].to_pylist()[::-1]
    pq.write_table(table.set_column(table.schema.get_field_index("episode_index"), "episode_index", [swapped]), path)
    with pytest.raises(AdaManipError, match="episode 0: its rows are not where they should be"):
        filter_episodes(tmp_path / "copy", [], tmp_path / "part")
    assert not (tmp_path / "part").exists()


def test_the_commands_count_write_and_report(
    unpictured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ["--where", "episode_index=0:4", "--where", "object_id=safe_000"]
    assert main(["filter", str(unpictured), *where, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {"out": None, "episodes": 2, "chosen": [0, 2]}
    assert list(tmp_path.iterdir()) == []
    assert main(["filter", str(unpictured), *where, "--out", str(tmp_path / "part")]) == 0
    assert capsys.readouterr().out == f"2 episodes in {tmp_path / 'part'}\n"
    assert load_check(tmp_path / "part")["total_episodes"] == 2
    shares = ["--parts", "train=0.5,validation=0.5", "--by", "object_id", "--json"]
    assert main(["split", str(unpictured), "--out", str(tmp_path / "parts"), *shares]) == 0
    parts = json.loads(capsys.readouterr().out)["parts"]
    objects = episode_table(unpictured)["object_id"].to_pylist()
    assert [len({objects[index] for index in mine}) for mine in parts.values()] == [1, 1]
