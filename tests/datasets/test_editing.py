"""Filter, split and merge: nothing is changed but indices, and all parts of a dataset are the dataset again."""

from __future__ import annotations

import itertools
import json
import re
import shutil
from pathlib import Path

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from demos_helpers import another
from lerobot.datasets.dataset_writer import DatasetWriter
from lerobot.datasets.video_utils import concatenate_video_files
from lerobot.utils.io_utils import write_video

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.memory import TEXT
from lerobot_adamanip.datasets import cutting
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.editing import filter_episodes, merge, split_episodes
from lerobot_adamanip.datasets.memory import add_memory
from lerobot_adamanip.datasets.pose_statistics import leave_poses_unscaled
from lerobot_adamanip.datasets.selection import read_selection, selection_path
from lerobot_adamanip.util.errors import AdaManipError

HALVES = {"one": 0.5, "other": 0.5}
NUMBERED = ("episode_index", "index")
STATS = Path("meta/stats.json")


@pytest.fixture(scope="module", params=["pictures", "no pictures"])
def whole(request: pytest.FixtureRequest, finished: Path, unpictured: Path) -> Path:
    """A dataset. Not to be written to."""
    return finished if request.param == "pictures" else unpictured


def rows(root: Path) -> dict[str, np.ndarray]:
    table = pq.read_table(sorted((root / "data").glob("*/*.parquet"))).sort_by("index")
    return {name: np.asarray(table[name].to_pylist()) for name in table.column_names}


def same(first: Path, second: Path) -> None:
    """Asserts that two datasets are equal; statistics to what is lost when single precision is stored as text."""
    for path in sorted(path for path in first.rglob("*") if path.is_file() and path.name != "README.md"):
        name, copy = path.relative_to(first), second / path.relative_to(first)
        if name == STATS:
            one, other = (json.loads(each.read_text()) for each in (path, copy))
            assert [(key, list(values)) for key, values in one.items()] == [(key, list(v)) for key, v in other.items()]
            for key, values in one.items():
                for statistic, value in values.items():
                    np.testing.assert_allclose(other[key][statistic], value, rtol=1e-6, atol=1e-9, err_msg=key)
        elif name.suffix == ".parquet":
            assert pq.read_table(path).equals(pq.read_table(copy)), name
        elif name.name == "info.json":
            assert json.loads(path.read_text()) == json.loads(copy.read_text())
        else:
            assert path.read_bytes() == copy.read_bytes(), name


@pytest.mark.parametrize("by", ["episode_index", "object_id", "hidden.locked"])
def test_all_parts_together_are_the_dataset_again(
    whole: Path, by: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cutting, "_encoded_anew", lambda *_: pytest.fail("pictures were encoded again"))
    parts = split_episodes(whole, tmp_path / "parts", HALVES if by != "hidden.locked" else None, by=by, seed=1)
    assert sorted(index for mine in parts.values() for index in mine) == list(range(6))
    assert len(parts) == 2
    merged = merge([tmp_path / "parts" / name for name in reversed(parts)], tmp_path / "again")
    assert (merged.episodes, merged.parts_of_one, merged.whole) == (6, True, True)
    same(whole, tmp_path / "again")
    assert not selection_path(tmp_path / "again").exists()


def test_parts_of_parts_find_together(unpictured: Path, tmp_path: Path) -> None:
    split_episodes(unpictured, tmp_path / "parts", HALVES, seed=4)
    filter_episodes(tmp_path / "parts" / "one", ["episode_index=1:3"], tmp_path / "end")
    filter_episodes(tmp_path / "parts" / "one", ["episode_index=0"], tmp_path / "begin")
    half = merge([tmp_path / "end", tmp_path / "begin"], tmp_path / "half")
    assert (half.parts_of_one, half.whole) == (True, False)
    found, wanted = (json.loads(selection_path(tmp_path / name).read_text()) for name in ("half", "parts/one"))
    assert [command.split()[:2] for command in wanted.pop("made_with")] == [["adamanip", "split"]]
    assert found == {**wanted, "made_with": []}
    merge([tmp_path / "parts" / "other", tmp_path / "end", tmp_path / "begin"], tmp_path / "again")
    same(unpictured, tmp_path / "again")


def test_a_filtered_dataset_holds_those_episodes_as_they_were(whole: Path, tmp_path: Path) -> None:
    chosen = filter_episodes(whole, ["hidden.locked=true"], tmp_path / "locked")
    locked = [json.loads(text)["locked"] for text in Dataset(whole).table["hidden_state"].to_pylist()]
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


def test_a_condition_too_long_for_a_card_leaves_a_part_that_can_be_read(unpictured: Path, tmp_path: Path) -> None:
    condition = f"episode_index={','.join(map(str, range(0, 2000, 2)))}"
    filter_episodes(unpictured, [condition], tmp_path / "part")
    assert read_selection(tmp_path / "part", 3).made_with == ()
    filter_episodes(tmp_path / "part", ["episode_index=0"], tmp_path / "one")
    (command,) = read_selection(tmp_path / "one", 1).made_with
    assert "episode_index=0" in command


def test_poses_stay_unscaled(unpictured: Path, tmp_path: Path) -> None:
    shutil.copytree(unpictured, tmp_path / "copy")
    leave_poses_unscaled(tmp_path / "copy")
    for root, name in ((unpictured, "scaled"), (tmp_path / "copy", "unscaled")):
        filter_episodes(root, ["episode_index=0:4"], tmp_path / name)
    statistics = [json.loads((tmp_path / name / "meta" / "stats.json").read_text()) for name in ("scaled", "unscaled")]
    deviations = [each["action"]["std"][3:] for each in statistics]
    assert deviations[0] != deviations[1] == [1.0] * 7


@pytest.mark.parametrize("rows_each", [1000, 5])
def test_rows_are_found_however_a_file_is_laid_out(unpictured: Path, tmp_path: Path, rows_each: int) -> None:
    shutil.copytree(unpictured, tmp_path / "copy")
    (path,) = (tmp_path / "copy" / "data").rglob("*.parquet")
    pq.write_table(pq.read_table(path), path, row_group_size=rows_each)
    for root in (unpictured, tmp_path / "copy"):
        filter_episodes(root, ["episode_index=1,2,4"], tmp_path / f"part of {root.name}")
    one, other = (rows(tmp_path / f"part of {name}") for name in ("dataset", "copy"))
    for name, values in one.items():
        np.testing.assert_array_equal(other[name], values, err_msg=name)


def test_columns_of_episodes_cameras_and_manifest_stay(whole: Path, tmp_path: Path) -> None:
    filter_episodes(whole, ["episode_index=2,4"], tmp_path / "part")
    before, after = (Dataset(root).table for root in (whole, tmp_path / "part"))
    assert before.column_names == after.column_names
    own = [name for name in Dataset(whole).own_columns.column_names if name != "episode_index"]
    assert {"object_id", "seed", "hidden_state", "start", "camera", "versions"} <= set(own)
    for name in own:
        assert after[name].type == before[name].type
        assert after[name].to_pylist() == [before[name][index].as_py() for index in (2, 4)], name
    for name in ("collection.json", "attempts.jsonl"):
        assert (tmp_path / "part" / "meta" / name).read_bytes() == (whole / "meta" / name).read_bytes()
    (cameras,) = json.loads((tmp_path / "part" / "meta" / "cameras.json").read_text()).values()
    assert cameras["per_episode"] == ["cam_in_base"]


def test_datasets_come_one_after_another(finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = another(finished, tmp_path / "copy")
    info = Dataset(copy).info
    info["features"][schema.FRONT_IMAGE]["info"]["video.crf"] = 30
    (copy / "meta" / "info.json").write_text(json.dumps(info))
    assert main(["merge", str(finished), str(copy), "--out", str(tmp_path / "both"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["parts_of_one"], told["whole"], told["mixed_versions"]) == (False, False, "")
    assert told["episodes"] == len(Dataset(tmp_path / "both")) == 12
    part, both = rows(finished), rows(tmp_path / "both")
    count = len(part["index"])
    assert set(both) == set(part)
    for name, values in part.items():
        shift = {"index": count, "episode_index": 6}.get(name, 0)
        np.testing.assert_array_equal(both[name][:count], values, err_msg=name)
        np.testing.assert_array_equal(both[name][count:], values + shift if shift else values, err_msg=name)
    kept = ["object_id", "hidden_state", "success", "start", "versions"]
    one, two = (Dataset(root).table.select(kept).to_pylist() for root in (finished, tmp_path / "both"))
    assert two == 2 * one
    # What differs between them is told where they agree.
    old, new = (Dataset(root).features[schema.FRONT_IMAGE]["info"] for root in (finished, tmp_path / "both"))
    assert new == {name: value for name, value in old.items() if name != "video.crf"}


def test_what_cannot_be_merged_is_one_clear_error_and_leaves_nothing(
    finished: Path, unpictured: Path, tmp_path: Path
) -> None:
    filter_episodes(unpictured, ["episode_index=1:3"], tmp_path / "part")
    filter_episodes(unpictured, ["episode_index=2:6"], tmp_path / "high")
    third = another(unpictured, tmp_path / "third")
    merge([unpictured, third], tmp_path / "merged")
    for parts, said in (
        ([finished], "nothing to merge"),
        ([finished, tmp_path / "none"], "none"),
        ([finished, finished.parent / ".." / finished.parent.name / finished.name], "share episodes"),
        ([finished, unpictured], r"different features(.|\n)*images\.front(.|\n)*adamanip render"),
        ([third, tmp_path / "part", unpictured], r"share episodes(.|\n)*2 of them: 1, 2 "),
        ([tmp_path / "part", tmp_path / "high"], r"share episodes(.|\n)*1 of them: 2 "),
        ([tmp_path / "merged", unpictured], r"share episodes(.|\n)*6 of them: \d+, .*\(seeds\)"),
        ([tmp_path / "merged", tmp_path / "part"], r"share episodes(.|\n)*2 of them: .*\(seeds\)"),
    ):
        with pytest.raises(AdaManipError, match=said):
            merge(parts, tmp_path / "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["high", "merged", "part", "third"]


@pytest.mark.parametrize("has_manifest", [True, False])
def test_episodes_with_a_memory_in_their_tasks_are_not_merged_with_those_without(
    unpictured: Path, tmp_path: Path, has_manifest: bool
) -> None:
    split_episodes(unpictured, tmp_path / "parts", HALVES)
    plain, silent = tmp_path / "parts" / "one", tmp_path / "silent"
    add_memory(tmp_path / "parts" / "other", tmp_path / "text", TEXT)
    manifest = (tmp_path / "text" / "meta" / "collection.json").read_bytes()
    for root in (tmp_path / "text", plain)[: 0 if has_manifest else 2]:
        (root / "meta" / "collection.json").unlink()
    for roots in itertools.permutations((plain, tmp_path / "text")):
        with pytest.raises(AdaManipError, match=r"has memory unlike(.|\n)*adamanip memory"):
            merge(roots, tmp_path / "new")
    # Nobody has felt a try yet in a part whose manifest alone says that it has a memory.
    shutil.copytree(plain, silent)
    (silent / "meta" / "collection.json").write_bytes(manifest)
    with pytest.raises(AdaManipError, match="a memory already"):
        add_memory(silent, tmp_path / "twice", TEXT)
    assert merge([silent, tmp_path / "text"], tmp_path / "new").whole


@pytest.mark.parametrize("driver", ["static", "dp3_adaptive"])
def test_episodes_of_other_drivers_in_the_same_scenes_are_others(unpictured: Path, tmp_path: Path, driver: str) -> None:
    """Two rounds of corrections may even be equal, where the expert has driven all key frames."""
    other = Path(shutil.copytree(unpictured, tmp_path / "other"))
    for path in (other / "meta" / "episodes").glob("*/*.parquet"):
        table = pq.read_table(path)
        place = table.column_names.index("expert")
        pq.write_table(table.set_column(place, table.field(place), pa.array([driver] * len(table))), path)
    assert merge([unpictured, other], tmp_path / "both").episodes == 12
    if driver == "dp3_adaptive":  # the second round
        merge([other, unpictured], tmp_path / "again")
        assert merge([tmp_path / "again", other], tmp_path / "rounds").episodes == 18


def test_a_lerobot_with_another_writer_is_refused(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(DatasetWriter, "_save_episode_video")
    with pytest.raises(AdaManipError, match="writes datasets differently"):
        filter_episodes(finished, [], tmp_path / "new")
    assert not (tmp_path / "new").exists()


# Videos -----------------------------------------------------------------------------------------------------------


def test_packets_are_copied_and_encoded_anew_only_where_they_must(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = Dataset(finished)
    (file,) = (finished / "videos").rglob("*.mp4")
    episode = source.episodes[2]
    first, length = episode.start, episode.length
    assert cutting._copied(file, tmp_path / "cut.mp4", (first, first + length), schema.FPS) == length
    ramp = [np.full((64, 64, 3), 20 * number, np.uint8) for number in range(10)]
    write_video(tmp_path / "one_key_frame.mp4", ramp, schema.FPS)
    assert cutting._copied(tmp_path / "one_key_frame.mp4", tmp_path / "other.mp4", (3, 7), schema.FPS) is None
    assert cutting._copied(file, tmp_path / "third.mp4", (first, first + length), schema.FPS, "av1") is None
    seen = frames(file)
    np.testing.assert_array_equal(frames(tmp_path / "cut.mp4"), seen[first : first + length])
    monkeypatch.setattr(cutting, "_copied", lambda *_: None)
    feature = source.features[schema.FRONT_IMAGE]
    anew = cutting.cut_episode(finished, schema.FRONT_IMAGE, feature, episode.row, schema.FPS)
    (tmp_path / "anew.mp4").write_bytes(anew)
    difference = np.abs(frames(tmp_path / "anew.mp4").astype(int) - seen[first : first + length])
    assert difference.max() < 12


@pytest.mark.parametrize("order", [(0, 2), (2, 0)])
def test_videos_with_and_without_b_frames_are_copied_in_any_order(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, order: tuple[int, int]
) -> None:
    monkeypatch.setattr(cutting, "_encoded_anew", lambda *_: pytest.fail("pictures were encoded again"))
    shutil.copytree(finished, tmp_path / "one")
    another(finished, tmp_path / "other")
    seen = []
    for name, b_frames in zip(("one", "other"), order, strict=True):
        seen += encode_with_b_frames(tmp_path / name, b_frames)
    merge([tmp_path / "one", tmp_path / "other"], tmp_path / "both")
    filter_episodes(tmp_path / "both", [], tmp_path / "again")
    for name in ("both", "again"):
        files = sorted((tmp_path / name / "videos").rglob("*.mp4"))
        assert len(files) == 2
        np.testing.assert_array_equal(np.concatenate([frames(path) for path in files]), np.concatenate(seen))
        assert Dataset(tmp_path / name).info["video_files_size_in_mb"] > 0


def encode_with_b_frames(root: Path, count: int) -> list[np.ndarray]:
    """Encodes a dataset's video again, each episode by itself as LeRobot does; returns the frames of each."""
    (file,) = (root / "videos").rglob("*.mp4")
    pictures, parts = frames(file), []
    for episode in Dataset(root).episodes:
        parts.append(root.with_name(f"{root.name}-{episode.number}.mp4"))
        with av.open(str(parts[-1]), "w") as container:
            stream = container.add_stream("libx264", schema.FPS, options={"bf": str(count)})
            stream.height, stream.width = pictures.shape[1:3]
            for picture in (*pictures[episode.start : episode.end], None):
                container.mux(stream.encode(None if picture is None else av.VideoFrame.from_ndarray(picture)))
    concatenate_video_files(parts, file)
    path = root / "meta" / "info.json"
    path.write_text(path.read_text().replace('"video.codec": "av1"', '"video.codec": "h264"'))
    return [frames(part) for part in parts]


def frames(path: Path) -> np.ndarray:
    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


# Damage -----------------------------------------------------------------------------------------------------------


DAMAGES = {
    "a short video": "does not fit its episode",
    "half a video": r"half written or damaged(.|\n)*file-000\.mp4: ",
    "no video where it should be": r"half written or damaged(.|\n)*file-000\.mp4: .*No such file",
    "no picture in a video": r"half written or damaged(.|\n)*file-000\.mp4: ",
    "swapped rows": "episode 0: its rows are not where they",
    "a missing task": r"half written or damaged(.|\n)*tasks\.parquet: lacks task 0 of episode 0",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_named_and_leaves_nothing(finished: Path, tmp_path: Path, damage: str) -> None:
    copy = Path(shutil.copytree(finished, tmp_path / "copy"))
    (file,) = (copy / "videos").rglob("*.mp4")
    if damage == "a short video":
        cutting._copied(file, tmp_path / "short.mp4", (0, 10), schema.FPS)
        shutil.move(tmp_path / "short.mp4", file)
    elif damage == "half a video":
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    elif damage == "no video where it should be":
        file.rename(file.with_name("file-007.mp4"))
    elif damage == "no picture in a video":
        with av.open(str(file), "w") as container:
            container.add_stream("aac", 8000)
            container.start_encoding()
    elif damage == "a missing task":
        table = pq.read_table(copy / "meta" / "tasks.parquet")
        numbers = pa.array([7] * len(table), pa.int64())
        at = table.schema.get_field_index("task_index")
        pq.write_table(table.set_column(at, "task_index", numbers), copy / "meta" / "tasks.parquet")
    else:
        (path,) = (copy / "data").rglob("*.parquet")
        table = pq.read_table(path)
        at = table.schema.get_field_index("episode_index")
        pq.write_table(table.set_column(at, "episode_index", [table["episode_index"].to_pylist()[::-1]]), path)
    with pytest.raises(AdaManipError, match=DAMAGES[damage]):
        filter_episodes(copy, [], tmp_path / "part")
    assert not (tmp_path / "part").exists()


@pytest.mark.parametrize(
    "content",
    [
        "no json",
        "{}",
        json.dumps({"format": 1, "source": "0" * 32, "source_episodes": 6, "episodes": [0, 9], "made_with": []}),
    ],
)
def test_a_selection_that_cannot_be_is_one_clear_error(tmp_path: Path, content: str) -> None:
    selection_path(tmp_path).parent.mkdir()
    selection_path(tmp_path).write_text(content)
    with pytest.raises(AdaManipError, match="which episodes"):
        read_selection(tmp_path, 2)


# Commands ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--parts", "a=0.5,b=0.6"], "not shares of one"),
        (["--parts", "a=1"], "not shares of one"),
        (["--parts", "a=0.5,b=0.5", "--seed", "-1"], "seed is negative"),
        (["--parts", "a=0.5,a=0.5"], "Wrong parts"),
        (["--parts", "../a=0.5,b=0.5"], "Wrong parts"),
        (["--parts", "a=half,b=0.5"], "Wrong parts"),
        (["--parts", "a=0.8,b=nan"], "not shares of one"),
        ([], "Wrong parts"),
        (["--by", "nothing"], "has this"),
        (["--parts", "a=0.2,b=0.3,c=0.5", "--by", "object_id"], "fewer values than parts"),
        (["--by", "task"], "name of a folder"),
    ],
)
def test_what_cannot_be_parted_is_one_clear_error(
    unpictured: Path, tmp_path: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["split", str(unpictured), "--out", str(tmp_path / "parts"), *options]) == 2
    assert re.search(said, capsys.readouterr().err)
    assert list(tmp_path.iterdir()) == []


def test_the_commands_count_write_and_report(
    unpictured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ["--where", "episode_index=0:4", "--where", "object_id=safe_000"]
    assert main(["filter", str(unpictured), *where, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"out": None, "episodes": 2, "chosen": [0, 2]}
    assert list(tmp_path.iterdir()) == []
    assert main(["filter", str(unpictured), *where, "--out", str(tmp_path / "part")]) == 0
    assert capsys.readouterr().out == f"2 episodes in {tmp_path / 'part'}\n"
    assert len(Dataset(tmp_path / "part")) == 2
    shares = ["--parts", "train=0.5,validation=0.5", "--by", "object_id", "--json"]
    assert main(["split", str(unpictured), "--out", str(tmp_path / "parts"), *shares]) == 0
    parts = json.loads(capsys.readouterr().out)["parts"]
    objects = Dataset(unpictured).table["object_id"].to_pylist()
    assert [len({objects[index] for index in mine}) for mine in parts.values()] == [1, 1]
