from __future__ import annotations

import importlib.util
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from demos_helpers import LATE, fakes, make_spec, patiently

from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.collection.record import EpisodeRequest, attempt_episode
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.versions import DATA_VERSION, SIMULATION_VERSION, cpu_model
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.dataset import Dataset, open_dataset, read_back
from lerobot_adamanip.datasets.episode import RESET
from lerobot_adamanip.datasets.manifest import read_manifest
from lerobot_adamanip.datasets.shards import RecordedEpisode
from lerobot_adamanip.util.errors import DatasetError

Refuses = Callable[[type, Callable[[], Any]], str]


@pytest.fixture
def copy(tmp_path: Path, finished: Path) -> Path:
    """A dataset that a test may damage."""
    return Path(shutil.copytree(finished, tmp_path / "copy"))


def again(row: dict[str, Any]) -> RecordedEpisode:
    """Records an episode of the small collection once more."""
    env, overrides = fakes().environment(make_spec().environment_of("safe")), json.loads(row["hidden_overrides"])
    request = EpisodeRequest(row["object_id"], row["seed"], overrides)
    attempt, episode = attempt_episode(env, make_spec(), fakes().expert, request)
    assert attempt.success
    return episode


def test_rows_are_the_episodes_that_happen_from_the_stored_seeds(finished: Path) -> None:
    dataset = open_dataset(finished, video_backend="pyav")
    assert dataset.num_episodes == 6
    for row in Dataset(finished).table.to_pylist():
        episode = again(row)
        assert len(episode) == row["length"]
        for t in range(len(episode)):
            item = dataset[row["dataset_from_index"] + t]
            for key, column in episode.columns.items():
                if key != schema.FRONT_IMAGE:
                    np.testing.assert_array_equal(np.atleast_1d(item[key].numpy()), column[t], err_msg=key)
            image = item[schema.FRONT_IMAGE].numpy().transpose(1, 2, 0) * 255.0
            assert np.abs(image - episode.columns[schema.FRONT_IMAGE][t]).mean() < 12.0  # chroma is coded coarsely
            assert item["task"] == "open the fake"


def test_every_episode_ends_past_success_in_one_terminal_row(finished: Path) -> None:
    dataset = open_dataset(finished, video_backend="pyav")
    for row in Dataset(finished).table.to_pylist():
        items = [dataset[index] for index in range(row["dataset_from_index"], row["dataset_to_index"])]
        assert [bool(item[schema.DONE]) for item in items] == [False] * (len(items) - 1) + [True]
        success = [bool(item[schema.SUCCESS]) for item in items]
        assert success == sorted(success)
        assert sum(success) >= 3  # success, farther, and the end
        assert sum(bool(item[schema.FAILED]) for item in items) == row["failed_tries"]
        assert sum(int(item[schema.TRIED]) >= 0 for item in items) == row["tries"]


def test_every_episode_tells_what_it_was_and_what_made_it(finished: Path) -> None:
    dataset = open_dataset(finished)
    versions = read_manifest(manifest_path(finished)).versions
    seen, starts = set(), []
    for index in range(dataset.num_episodes):
        row = dataset.meta.episodes[index]
        locked = json.loads(row["hidden_state"])["locked"]
        start = json.loads(row["start"])
        starts.append(start != RESET)
        assert row["late"] == starts[-1]
        assert row["failed_tries"] == (1 if locked else 0) or row["late"]
        assert row["success"] is True
        assert row["expert"] == "adaptive"
        assert row["attempts"] == 1 + len(json.loads(row["failures"])) == row["attempt"] + 1
        assert json.loads(row["camera"])["cam_in_base"][0][3] == pytest.approx(0.01 * row["seed"])
        assert json.loads(row["versions"]) == {**versions, "cpu": cpu_model()}
        assert {"lerobot", "torch", "python", "numpy", "gymnasium"} < versions.keys()
        assert (row["simulation_version"], row["data_version"]) == (SIMULATION_VERSION, DATA_VERSION)
        seen.add((row["object_id"], row["slot"]))
    assert len(seen) == 6
    assert 0 < np.mean(starts) < 1
    assert LATE == 0.5
    filtered = open_dataset(finished, episode_filter=lambda row: row["object_id"] == "safe_001")
    assert filtered.num_episodes == 3


def test_the_hidden_state_is_in_no_column_a_policy_reads(finished: Path) -> None:
    features = Dataset(finished).features
    inputs = {key for key in features if key.startswith("observation.")}
    assert inputs == {schema.POINT_CLOUD, schema.STATE, schema.EFFORT, schema.FRONT_IMAGE}


def test_cameras_travel_with_the_dataset(finished: Path) -> None:
    front = json.loads((finished / "meta" / "cameras.json").read_text())["front"]
    assert front["constant"]["intrinsics"] == np.eye(3).tolist()
    assert front["per_episode"] == ["cam_in_base"]
    assert Dataset(finished).features[schema.FRONT_IMAGE]["info"]["intrinsics"] == np.eye(3).tolist()


def test_an_unfinished_dataset_says_how_to_finish(tmp_path: Path, refuses: Refuses) -> None:
    def interrupt(stage: str, done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(tmp_path / "dataset", make_spec(), fakes(), patiently(), interrupt)
    message = refuses(DatasetError, lambda: open_dataset(tmp_path / "dataset"))
    assert "2 episodes" in message
    assert "resumes" in message


@pytest.mark.parametrize("name", ["data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"])
def test_a_file_without_its_footer_or_a_row_is_half_written(copy: Path, refuses: Refuses, name: str) -> None:
    content = (copy / name).read_bytes()
    (copy / name).write_bytes(content[: len(content) // 2])
    assert "half written" in refuses(DatasetError, lambda: Dataset(copy))
    (copy / name).write_bytes(content)
    pq.write_table(pq.read_table(copy / name).slice(0, 3), copy / name)
    assert "3 rows" in refuses(DatasetError, lambda: Dataset(copy))


def test_no_advice_costs_data(copy: Path, tmp_path: Path, refuses: Refuses, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work of the user lies beside a dataset, another format can be converted, and a repair mends counts."""
    monkeypatch.chdir(tmp_path)
    work = tmp_path / "work"
    shutil.copytree(copy, work / "demos")
    (work / "train").mkdir()
    (work / "notes.txt").touch()
    (work / "empty").mkdir()

    def advice(root: Path) -> str:
        message = refuses(DatasetError, lambda: Dataset(root))
        assert "delete" not in message
        assert "rm " not in message
        return message

    assert "work/demos, which is a dataset" in advice(work)
    assert "a folder with other files" in advice(work)
    assert "adamanip collect" not in advice(work) + advice(work / "empty") + advice(work / "notes.txt")
    assert "a file" in advice(work / "notes.txt")
    assert "adamanip collect work/new" in advice(work / "new")
    path = work / "demos" / "meta" / "info.json"
    info = json.loads(path.read_text())
    path.write_text(json.dumps({**info, "total_frames": 9}))
    assert "adamanip check work/demos --repair" in advice(work / "demos")
    old = {**info, "codebase_version": "v2.1", "data_path": "data/{episode_chunk:03d}/{episode_index}.parquet"}
    path.write_text(json.dumps(old))
    (work / "demos" / "meta" / "stats.json").unlink()  # which v2.1 has not
    told = advice(work / "demos")
    module = told.partition("python -m ")[2].split()[0]
    assert importlib.util.find_spec(module) is not None
    assert "v2.1" in told
    assert any("convert_dataset" in str(each) for each in check(work / "demos").findings)


@pytest.mark.parametrize("name", ["meta/info.json", "meta/stats.json", "data", "videos", "meta/episodes"])
def test_a_dataset_that_lacks_a_part_is_half_written(copy: Path, refuses: Refuses, name: str) -> None:
    (copy / name).rename(copy.with_name("elsewhere"))
    assert "half written" in refuses(DatasetError, lambda: Dataset(copy))


def test_another_layout_is_one_clear_error(copy: Path, refuses: Refuses) -> None:
    path = copy / "meta" / "info.json"
    content = path.read_text()
    for key in (schema.STATE, schema.ACTION, schema.POINT_CLOUD):
        info = json.loads(content)
        info["features"][key]["shape"] = [5]
        path.write_text(json.dumps(info))
        assert key in refuses(DatasetError, lambda: Dataset(copy))
        del info["features"][key]
        path.write_text(json.dumps(info))
        assert "missing" in refuses(DatasetError, lambda: Dataset(copy))


def test_a_dataset_is_read_back_whole(finished: Path, copy: Path, refuses: Refuses) -> None:
    lengths = [row["length"] for row in Dataset(finished).table.to_pylist()]
    read_back(finished, lengths)
    read_back(finished)
    assert "were written" in refuses(DatasetError, lambda: read_back(finished, [*lengths, 3]))
    (video,) = (copy / "videos" / schema.FRONT_IMAGE).glob("*/*.mp4")
    content = video.read_bytes()
    for damaged in (content[: len(content) // 2], b"", content.replace(content[2000:4000], bytes(2000))):
        video.write_bytes(damaged)
        Dataset(copy)  # which does not decode
        refuses(DatasetError, lambda: read_back(copy))


def test_a_hint_quotes_a_folder_that_a_shell_would_split(
    finished: Path, tmp_path: Path, refuses: Refuses, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = Path(shutil.copytree(finished, tmp_path / "my demos"))
    monkeypatch.chdir(tmp_path)
    (file,) = (root / "data").rglob("*.parquet")
    file.write_bytes(b"")
    assert "adamanip check 'my demos' --repair" in refuses(DatasetError, lambda: Dataset(root))
