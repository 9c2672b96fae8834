"""Every damage is found, named and placed, nothing else is; and what a repair mends is clean afterwards."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import check_damages as to
import numpy as np
import pyarrow.parquet as pq
import pytest
from check_damages import ATTEMPTS, CAMERAS, COLLECTION, DATA, INFO, META, STATS, TASKS, VIDEO, Damage
from sound_demos import collect_sound, make_sound_env

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.collection.replay import check_replays
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets import editing
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.check.findings import KINDS, MOST_OF_A_KIND, WARNINGS, Report, Rows
from lerobot_adamanip.datasets.check.statistics import check_episode_statistics
from lerobot_adamanip.datasets.dataset import open_dataset
from lerobot_adamanip.datasets.editing import merge
from lerobot_adamanip.datasets.repair import repair

NAN = float("nan")
DAMAGES = [
    Damage("data cut off", to.cut(DATA, 0.5), [("unreadable", DATA, 0, None)]),
    Damage("data lost", to.remove(DATA), [("missing", DATA, 0, None)]),
    Damage("pages overwritten", to.break_pages(2), [("unreadable", DATA, 2, None)]),
    Damage("video lost", to.remove(VIDEO), [("missing", VIDEO, 0, None)]),
    Damage("video cut off", to.cut(VIDEO, 0.7), [("unreadable", VIDEO, 3, 3)]),
    Damage("video short", to.edit_film(lambda frames: frames[:-2]), [("video-length", VIDEO, 5, 2)]),
    Damage(
        "video of another episode", to.edit_film(lambda frames: [*frames[4:8], *frames[:4], *frames[8:]]),
        [("video-content", VIDEO, 0, None), ("video-content", VIDEO, 1, None)],
    ),
    Damage(
        "video shifted", to.edit_episode(3, **{f"videos/{schema.FRONT_IMAGE}/to_timestamp": lambda end: end + 1.0}),
        [("video-length", META, 3, None)],
    ),
    Damage("NaN", to.edit_cell(schema.STATE, 3, 2, to.at((5,), NAN)), [("not-finite", DATA, 3, 2)]),
    Damage("wrong shape", to.edit_cell(schema.POINT_CLOUD, 4, 5, lambda cloud: cloud[:-1]), [("shape", DATA, 4, 5)]),
    Damage("empty cell", to.edit_cell(schema.PROGRESS, 2, 3, lambda _: None), [("shape", DATA, 2, 3)]),
    Damage("rotation of no rotation", to.edit_cell(schema.ACTION, 0, 1, to.at((3,), 0.5)), [("rotation", DATA, 0, 1)]),
    Damage("hand too open", to.edit_cell(schema.STATE, 2, 0, to.at((9,), 1.5)), [("gripper", DATA, 2, 0)]),
    Damage("point far away", to.edit_cell(schema.POINT_CLOUD, 5, 3, to.at((0,), 9.0)), [("workspace", DATA, 5, 3)]),
    Damage("row lost", to.without_row(3, 2), [("length", DATA, 3, None)]),
    Damage("index jumps", to.edit_cell("index", 2, 1, lambda _: 99), [("index", DATA, 2, 1)]),
    Damage("row of another episode", to.edit_cell("episode_index", 1, 3, lambda _: 4), [("index", DATA, 1, 3)]),
    Damage("time stands still", to.edit_cell("timestamp", 3, 4, lambda _: 0.75), [("timestamp", DATA, 3, 4)]),
    Damage("unknown task", to.edit_cell("task_index", 0, 2, lambda _: 7), [("task", DATA, 0, 2)]),
    Damage("label of no code", to.edit_cell(schema.PHASE, 1, 2, lambda _: 17), [("label", DATA, 1, 2)]),
    Damage("failed without a try", to.edit_cell(schema.TRIED, 3, 1, lambda _: -1), [("label", DATA, 3, 1)]),
    Damage("no end", to.edit_cell(schema.DONE, 4, 5, lambda _: False), [("label", DATA, 4, 5)]),
    Damage(
        "episodes swapped", to.swap_contents(0, 1),
        [("episode-statistics", DATA, 0, None), ("episode-statistics", DATA, 1, None)],
    ),
    Damage("statistics of another dataset", to.edit_json(STATS, to.of_another),
           [("statistics", STATS, None, None)], mended=True),
    Damage("statistics lost", to.remove(STATS), [("missing", STATS, None, None)], mended=True),
    Damage("statistics of an episode", to.edit_episode(2, **{"stats/action/mean": to.more}),
           [("episode-statistics", DATA, 2, None)]),
    Damage("quantiles averaged", to.edit_json(STATS, lambda told: told["action"].update(q01=[0.0] * 10)),
           [("averaged", STATS, None, None)], mended=True),
    Damage("statistics of a cloud lost", to.edit_json(STATS, lambda told: told.pop(schema.POINT_CLOUD)),
           [("averaged", STATS, None, None)], mended=True),
    Damage("description lost", to.remove(INFO), [("missing", INFO, None, None)]),
    Damage("wrong totals", to.edit_json(INFO, lambda info: info.update(total_frames=29)),
           [("count", INFO, None, None)], mended=True),
    Damage("an option of an encoder",
           to.edit_json(INFO, lambda info: info["features"]["action"].update(info={"a": {"x264-params": "stats=x"}})),
           [("untrusted", INFO, None, None)]),
    Damage("older format", to.edit_json(INFO, lambda info: info.update(codebase_version="v2.1")),
           [("metadata", INFO, None, None)]),
    Damage("other names", to.edit_json(INFO, lambda info: info["features"]["action"].update(names=list("abcdefghij"))),
           [("schema", INFO, None, None)]),
    Damage("hidden state as an observation", to.edit_json(
        INFO, lambda info: info["features"].update({"observation.hidden": info["features"].pop(schema.TRIAL)})),
        [("schema", INFO, None, None), ("schema", INFO, None, None), ("schema", DATA, 0, None)]),
    Damage("tasks lost", to.remove(TASKS), [("missing", TASKS, None, None)]),
    Damage("metadata lost", to.without_metadata(4), [
        ("count", INFO, None, None), ("unlisted", DATA, 4, None), ("unlisted", VIDEO, None, None),
    ]),
    Damage("metadata contradicts itself", to.edit_episode(1, length=3), [
        ("count", INFO, None, None), ("metadata", META, 1, None), ("video-length", META, 1, None),
        ("length", DATA, 1, None),
    ]),
    Damage("object of no id", to.edit_episode(4, object_id="table_000"), [("facts", META, 4, None)]),
    Damage("tries miscounted", to.edit_episode(3, tries=9), [("facts", META, 3, None)]),
    Damage("record of another episode", to.edit_episode(0, episode_record=to.other_record), [("facts", META, 0, None)]),
    Damage("seed of no place", to.edit_episode(5, slot=1), [("collection", META, 5, None)]),
    Damage("collection of another format", to.edit_json(COLLECTION, lambda it: it.update(format=99)),
           [("collection", COLLECTION, None, None)]),
    Damage("other versions", to.edit_episode(1, versions='{"torch": "1.0"}'), [("versions", META, 1, None)]),
    Damage("attempts lost", to.drop_line, [("attempts", ATTEMPTS, None, None)]),
    Damage("camera lost", to.remove(CAMERAS), [("cameras", CAMERAS, None, None)], mended=True),
    Damage("orphaned picture", to.leave(f"images/{schema.FRONT_IMAGE}/episode-000006/frame-000000.png"),
           [("leftover", "images", None, None)], mended=True),
    Damage("temporary file", to.leave("meta/.info.json.17.tmp"),
           [("leftover", "meta/.info.json.17.tmp", None, None)], mended=True),
    Damage("data of nobody", to.copy_data, [("unlisted", "data/chunk-000/file-001.parquet", None, None)], mended=True),
]  # fmt: skip


@pytest.fixture
def copy(tmp_path: Path, published: Path) -> Path:
    """A sound dataset, which may be damaged."""
    return Path(shutil.copytree(published, tmp_path / "dataset"))


def places(root: Path) -> list[to.Place]:
    return [(found.kind, found.file, found.episode, found.frame) for found in check(root).findings]


def contents(root: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}


def test_nothing_is_found_in_a_sound_dataset_and_nothing_changed(published: Path) -> None:
    before = contents(published)
    result = check(published)
    assert result.findings == []
    assert (result.clean, result.episodes, result.rows) == (True, 6, 28)
    assert contents(published) == before


def test_every_kind_of_finding_has_a_damage() -> None:
    assert {kind for damage in DAMAGES for kind, *_ in damage.found} == set(KINDS) - {"replay", "limits"}


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.name)
def test_a_damage_alone_is_found_and_placed_and_what_a_repair_mends_is_clean(copy: Path, damage: Damage) -> None:
    damage.do(copy)
    assert sorted(places(copy), key=str) == sorted(damage.found, key=str)
    done = repair(copy)
    result = check(copy)
    assert (result.findings == []) == damage.mended
    if damage.mended:
        assert (done.left, result.episodes) == ([], 6)
        assert done.mended
        assert len(open_dataset(copy, video_backend="pyav")) == result.rows
    before = contents(copy)
    assert repair(copy).mended == []  # nothing is left to be done
    assert contents(copy) == before


def test_a_merged_dataset_is_clean_unless_an_episode_is_there_twice(
    published: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = published, collect_sound(tmp_path / "1", seed=1)
    merge([one, other], tmp_path / "both")
    assert check(tmp_path / "both").findings == []
    monkeypatch.setattr(editing, "_require_each_once", lambda sources: None)
    again = Path(shutil.copytree(one, tmp_path / "again"))
    (again / "meta" / "info.json").write_text(
        json.dumps(json.loads((one / "meta" / "info.json").read_text()), indent=1)
    )
    merge([one, again], tmp_path / "twice")
    found = check(tmp_path / "twice").findings
    assert {(each.kind, each.episode) for each in found} == {("facts", number) for number in range(6, 12)}


def test_a_dataset_without_columns_of_ours_is_clean(copy: Path) -> None:
    for name in ("collection.json", "attempts.jsonl"):
        (copy / "meta" / name).unlink()
    table = pq.read_table(copy / META)
    own = [name for name in table.column_names if "/" not in name and name not in to.OF_LEROBOT]
    pq.write_table(table.drop_columns(own), copy / META)
    assert check(copy).findings == []


def test_episodes_may_go_on_in_another_row_group(copy: Path) -> None:
    pq.write_table(pq.read_table(copy / DATA), copy / DATA, row_group_size=3)
    assert check(copy).findings == []


@pytest.mark.parametrize(("rows", "width"), [(20, 3072), (45, 1536)])
def test_lerobots_rounding_is_no_finding_and_a_true_difference_is(rows: int, width: int) -> None:
    from lerobot.datasets.compute_stats import get_feature_stats

    draw = np.random.default_rng(rows)
    values = (draw.uniform(0.3, 0.9, (rows, width)) // 0.1 * 0.1).astype(np.float32)
    key, where = schema.EFFORT, Rows(DATA, np.zeros(rows, np.int64), np.arange(rows))
    stats = get_feature_stats(values, 0, keepdims=False)
    told = {name: value[None].astype(float) for name, value in stats.items()}
    for name in (None, "min", "max", "mean", "std", "q10", "q50", "q90", "count"):
        report = Report()
        changed = told if name is None else {**told, name: told[name] * 1.1 + 0.03}
        check_episode_statistics(where, {key: values}, {key: changed}, {0: 0}, report)
        assert report.clean == (name is None), name


def test_findings_of_a_kind_are_listed_up_to_a_number_and_counted_beyond() -> None:
    report = Report()
    for episode in range(MOST_OF_A_KIND + 5):
        report.add("label", "wrong", DATA, episode, 0)
    assert len(report.findings) == MOST_OF_A_KIND
    assert report.counts["label"] == MOST_OF_A_KIND + 5
    with pytest.raises(ValueError, match="No kind"):
        report.add("odd", "wrong")


def test_what_is_taken_out_lies_beside_the_dataset(copy: Path) -> None:
    to.leave("meta/.info.json.17.tmp")(copy)
    to.edit_json(STATS, to.of_another)(copy)
    stats = (copy / STATS).read_bytes()
    backup = repair(copy).backup
    assert backup == copy.with_name("dataset.before-repair")
    assert (backup / STATS).read_bytes() == stats
    assert (backup / "meta/.info.json.17.tmp").read_bytes() == b"half"


def test_replays_tell_what_does_not_happen_again(copy: Path) -> None:
    told: list[tuple[str, int, int]] = []
    report = check_replays(copy, [0, 3], make_sound_env, tolerance=1e-4, progress=lambda *done: told.append(done))
    assert report.clean
    assert told == [("replay", 1, 2), ("replay", 2, 2)]
    to.edit_cell(schema.EXECUTED, 3, 0, lambda action: [action[0] + 0.05, *action[1:]])(copy)
    report = check_replays(copy, [0, 3], make_sound_env, tolerance=1e-4)
    assert [(each.kind, each.episode) for each in report.findings] == [("replay", 3)]


def test_the_command_tells_findings_and_mends_them(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(copy)]) == 0
    assert capsys.readouterr().out.rstrip().endswith("6 episodes, 28 rows: clean")
    to.edit_cell(schema.STATE, 3, 2, to.at((5,), NAN))(copy)
    to.remove(STATS)(copy)
    assert main(["check", str(copy)]) == 1
    out = capsys.readouterr().out
    assert f"not-finite: {DATA}, episode 3, frame 2: NaN or infinity in {schema.STATE}" in out
    assert "2 findings" in out
    assert main(["check", str(copy), "--json", "--repair"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["counts"] == {"not-finite": 1}
    place = {name: told["findings"][0][name] for name in ("kind", "file", "episode", "frame")}
    assert place == {"kind": "not-finite", "file": DATA, "episode": 3, "frame": 2}
    assert told["repair"]["mended"] == [f"{STATS}: computed again from the rows"]
    assert main(["check", str(copy), "--replay", "-1"]) == 2


def test_the_documented_kinds_are_the_codes(project_root: Path) -> None:
    text = (project_root / "docs" / "checking.md").read_text(encoding="utf-8")
    match = re.search(r"<!-- kinds -->\n(.*?)<!-- /kinds -->", text, re.DOTALL)
    assert match is not None
    documented = dict(re.findall(r"^\| `([a-z-]+)` \| (warning: )?", match[1], re.MULTILINE))
    assert documented.keys() == set(KINDS)
    assert {kind for kind, warning in documented.items() if warning} == WARNINGS


def test_an_episode_that_does_not_tell_its_place_is_a_finding(published: Path, tmp_path: Path) -> None:
    for name in ("slot", "attempt", "late"):
        root = Path(shutil.copytree(published, tmp_path / name))
        (path,) = (root / "meta" / "episodes").rglob("*.parquet")
        pq.write_table(pq.read_table(path).drop_columns([name]), path)
        assert "facts" in check(root).counts
