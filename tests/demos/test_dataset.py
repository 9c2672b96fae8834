from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from lerobot_adamanip import schema
from lerobot_adamanip.demos.collect import collect
from lerobot_adamanip.demos.collection import CollectionSpec
from lerobot_adamanip.demos.loading import episode_table, load_check, open_dataset
from lerobot_adamanip.demos.shards import write_shard
from lerobot_adamanip.demos.worker import attempt_episode, make_env
from lerobot_adamanip.errors import ConfigurationError, DatasetError
from lerobot_adamanip.hub import cards as card
from lerobot_adamanip.hub.publish import publish

Options = Callable[..., CollectionSpec]
Refuses = Callable[[type, Callable[[], Any]], str]


@pytest.fixture
def copy(tmp_path: Path, finished: Path) -> Path:
    """A dataset that a test may damage."""
    return Path(shutil.copytree(finished, tmp_path / "copy"))


def test_rows_are_the_episodes_that_happen_from_the_stored_seeds(finished: Path, options: Options) -> None:
    dataset = open_dataset(finished, video_backend="pyav")
    env = make_env(options(), options().objects[0])
    assert dataset.num_episodes == 6
    for row in episode_table(finished).to_pylist():
        result, episode = attempt_episode(env, options(), row["object_id"], row["seed"])
        assert result.success
        assert len(episode) == row["length"]
        for t in range(len(episode)):
            item = dataset[row["dataset_from_index"] + t]
            for key, column in episode.columns.items():
                if key != schema.FRONT_IMAGE:
                    np.testing.assert_array_equal(np.atleast_1d(item[key].numpy()), column[t], err_msg=key)
            image = item[schema.FRONT_IMAGE].numpy().transpose(1, 2, 0) * 255.0
            assert np.abs(image - episode.columns[schema.FRONT_IMAGE][t]).mean() < 12.0  # chroma is coded coarsely
            assert item["task"] == "open the fake"


def test_history_and_chunks_can_be_asked_for_by_time(finished: Path) -> None:
    deltas = {"action": [-1 / schema.FPS, 0.0, 1 / schema.FPS], schema.POINT_CLOUD: [-1 / schema.FPS, 0.0]}
    item = open_dataset(finished, video_backend="pyav", delta_timestamps=deltas)[0]
    assert item["action"].shape == (3, schema.ACTION_DIM)
    assert item[schema.POINT_CLOUD].shape == (2, 8, 3)
    assert item["action_is_pad"].tolist() == [True, False, False]


def test_every_episode_tells_its_object_seed_hidden_state_and_trials(finished: Path) -> None:
    dataset = open_dataset(finished)
    seen = set()
    for index in range(dataset.num_episodes):
        row = dataset.meta.episodes[index]
        locked = json.loads(row["hidden_state"])["locked"]
        assert row["trials"] == (2 if locked else 1)
        assert row["success"] is True
        assert row["expert"] == "adaptive"
        assert row["attempts"] == 1 + len(json.loads(row["failures"]))
        assert json.loads(row["camera"])["cam_in_base"][0][3] == pytest.approx(0.01 * row["seed"])
        assert "lerobot" in json.loads(row["versions"])
        seen.add((row["object_id"], row["slot"]))
    assert len(seen) == 6
    filtered = open_dataset(finished, episode_filter=lambda row: row["object_id"] == "fake_001")
    assert filtered.num_episodes == 3


def test_the_hidden_state_is_in_no_column_a_policy_reads(finished: Path) -> None:
    features = load_check(finished)["features"]
    inputs = {key for key in features if key.startswith("observation.")}
    assert inputs == {schema.POINT_CLOUD, schema.STATE, schema.EFFORT, schema.FRONT_IMAGE}


def test_statistics_of_rotation_and_gripper_are_their_true_range(finished: Path) -> None:
    stats = open_dataset(finished).meta.stats
    dims = list(schema.FIXED_RANGE_DIMS)
    for key in (schema.STATE, schema.ACTION):
        np.testing.assert_array_equal(stats[key]["min"][dims], -1.0)
        np.testing.assert_array_equal(stats[key]["max"][dims], 1.0)
        assert (stats[key]["max"][:3] < 0.7).all()


def test_cameras_travel_with_the_dataset(finished: Path) -> None:
    front = json.loads((finished / "meta" / "cameras.json").read_text())["front"]
    assert front["constant"]["intrinsics"] == np.eye(3).tolist()
    assert front["per_episode"] == ["cam_in_base"]
    assert load_check(finished)["features"][schema.FRONT_IMAGE]["info"]["intrinsics"] == np.eye(3).tolist()


def test_the_card_is_complete_and_its_command_is_the_datasets(finished: Path) -> None:
    text = (finished / "README.md").read_text()
    front_matter = yaml.safe_load(text.split("---")[1])
    assert front_matter["license"] == "apache-2.0"
    assert "LeRobot" in front_matter["tags"]
    assert "$" not in text.replace("$\\", "")
    assert "--objects fake_000,fake_001 --root dataset" in text


def test_card_templates_are_found_in_a_checkout_and_in_a_wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_checkout = card.card_template("dataset_card.md").template
    package = tmp_path / "lerobot_adamanip"
    (package / "hub_cards").mkdir(parents=True)
    (package / "hub_cards" / "dataset_card.md").write_text("wheel")
    monkeypatch.setattr(card.importlib.resources, "files", lambda name: package)
    assert card.card_template("dataset_card.md").template == "wheel" != in_checkout
    with pytest.raises(ConfigurationError, match="template"):
        card.card_template("nothing.md")


def test_a_missing_dataset_is_one_clear_error(tmp_path: Path, refuses: Refuses) -> None:
    assert "no dataset" in refuses(DatasetError, lambda: load_check(tmp_path / "nowhere"))


def test_an_unfinished_dataset_says_how_to_finish(tmp_path: Path, options: Options, refuses: Refuses) -> None:
    def interrupt(stage: str, done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(tmp_path / "dataset", options(), max_attempts=25, listener=interrupt)
    message = refuses(DatasetError, lambda: open_dataset(tmp_path / "dataset"))
    assert "2 episodes" in message
    assert "resumes" in message


@pytest.mark.parametrize("name", ["data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"])
def test_a_file_without_its_footer_is_half_written(copy: Path, refuses: Refuses, name: str) -> None:
    content = (copy / name).read_bytes()
    (copy / name).write_bytes(content[: len(content) // 2])
    assert "half written" in refuses(DatasetError, lambda: load_check(copy))


@pytest.mark.parametrize("name", ["meta/info.json", "meta/stats.json", "data", "videos", "meta/episodes"])
def test_a_dataset_that_lacks_a_part_is_half_written(copy: Path, refuses: Refuses, name: str) -> None:
    path = copy / name
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert "half written" in refuses(DatasetError, lambda: load_check(copy))


def test_missing_rows_are_noticed(copy: Path, refuses: Refuses) -> None:
    path = copy / "data/chunk-000/file-000.parquet"
    pq.write_table(pq.read_table(path).slice(0, 3), path)
    assert "3 rows" in refuses(DatasetError, lambda: load_check(copy))


def test_another_number_of_points_is_one_clear_error(finished: Path, refuses: Refuses) -> None:
    assert load_check(finished, num_points=8)
    message = refuses(DatasetError, lambda: load_check(finished, num_points=1024))
    assert "(8, 3)" in message
    assert "(1024, 3)" in message


@pytest.mark.parametrize("key", [schema.STATE, schema.ACTION, schema.POINT_CLOUD])
def test_another_layout_is_one_clear_error(copy: Path, refuses: Refuses, key: str) -> None:
    path = copy / "meta" / "info.json"
    info = json.loads(path.read_text())
    info["features"][key]["shape"] = [5]
    path.write_text(json.dumps(info))
    assert key in refuses(DatasetError, lambda: load_check(copy))
    del info["features"][key]
    path.write_text(json.dumps(info))
    assert "missing" in refuses(DatasetError, lambda: load_check(copy))


def test_publishing_uploads_under_the_licence_and_our_card(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import huggingface_hub
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    pushed: list[Any] = []
    monkeypatch.setattr(
        LeRobotDataset, "push_to_hub", lambda self, **kwargs: pushed.append((self.repo_id, self.root, kwargs))
    )
    monkeypatch.setattr(
        huggingface_hub.DatasetCard, "push_to_hub", lambda self, name, **kwargs: pushed.append((name, str(self)))
    )
    publish(finished, "someone/safes")
    (name, root, kwargs), (card_name, text) = pushed
    assert name == card_name == "someone/safes"
    assert root == finished
    assert kwargs["license"] == "apache-2.0"
    assert "adamanip" in kwargs["tags"]
    assert "AdaManip demonstrations" in text


@pytest.mark.parametrize("name", [None, "safes", "local/safes", "someone/"])
def test_publishing_needs_a_name_on_the_hub(finished: Path, refuses: Refuses, name: str) -> None:
    refuses(ConfigurationError, lambda: publish(finished, name))


def test_publishing_without_a_network_is_one_clear_error(finished: Path, refuses: Refuses) -> None:
    assert "login" in refuses(DatasetError, lambda: publish(finished, "someone/safes"))


def test_an_episode_file_holds_what_the_dataset_needs(tmp_path: Path, finished: Path, options: Options) -> None:
    row = episode_table(finished).to_pylist()[0]
    _, episode = attempt_episode(make_env(options(), row["object_id"]), options(), row["object_id"], row["seed"])
    write_shard(tmp_path / "episode", episode)
    assert set(episode.columns) == set(schema.dataset_features(8))
