"""Pictures added later are those that collecting with them would have given, whatever interrupts it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import demos_fake_env
import pytest
from demos_helpers import fakes, make_spec, same_bytes

from lerobot_adamanip.collection.collect import CollectOptions, collect
from lerobot_adamanip.collection.render import add_pictures
from lerobot_adamanip.collection.replay import replay
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import FRONT, WRIST, image_column
from lerobot_adamanip.contract.observation import observation_columns
from lerobot_adamanip.datasets.check.features import check_features
from lerobot_adamanip.datasets.check.findings import Report
from lerobot_adamanip.datasets.dataset import Dataset, open_dataset
from lerobot_adamanip.util.errors import DatasetError

Refuses = Callable[[type, Callable[[], Any]], str]


def make_env(options: Any) -> demos_fake_env.FakeEnv:
    return demos_fake_env.make_env(options)


def test_pictures_added_later_make_the_dataset_that_has_them_from_the_start(
    tmp_path: Path, unpictured: Path, finished: Path
) -> None:
    said: list[tuple[str, int, int]] = []
    out = tmp_path / finished.name
    assert add_pictures(unpictured, out, make_env, progress=lambda *told: said.append(told)) == 6
    same_bytes(finished, out)
    assert said[0] == ("render", 1, 6)
    assert said[-1] == ("assemble", 6, 6)
    assert not (tmp_path / f"{out.name}.partial").exists()


def test_a_second_camera_is_recorded_for_one_option(tmp_path: Path) -> None:
    env = make_env(make_spec(cameras=(FRONT, WRIST)).environment_of("safe"))
    observation, _ = env.reset(seed=1, options={"object_id": "safe_000"})
    assert observation_columns(observation).keys() >= {schema.FRONT_IMAGE, image_column(WRIST)}
    collect(out := tmp_path / "dataset", make_spec(cameras=(FRONT, WRIST)), fakes(), CollectOptions(workers=1))
    assert schema.dataset_features(8, 64).keys() < Dataset(out).features.keys()
    row = open_dataset(out, video_backend="pyav", return_uint8=True)[0]
    assert abs(row[image_column(WRIST)].float().mean() + row[schema.FRONT_IMAGE].float().mean() - 255) < 12
    report = Report()
    check_features(Dataset(out).features, report, collected=True)
    assert report.clean


def test_after_an_interruption_it_goes_on(tmp_path: Path, unpictured: Path, finished: Path) -> None:
    taken: list[int] = []

    class Counting(demos_fake_env.FakeEnv):
        def reset(self, **arguments: Any) -> Any:
            if len(taken) == 3:
                raise KeyboardInterrupt
            taken.append(arguments["seed"])
            return super().reset(**arguments)

    def factory(options: Any) -> Any:
        return Counting(options, delay=0.0, crash=None, hopeless=None, code="a")

    out = tmp_path / finished.name
    with pytest.raises(KeyboardInterrupt):
        add_pictures(unpictured, out, factory)
    assert not out.exists()
    first = list(taken)
    taken[:] = [0, 0]  # one more episode, then another interruption
    with pytest.raises(KeyboardInterrupt):
        add_pictures(unpictured, out, factory)
    assert set(taken[2:]).isdisjoint(first)
    add_pictures(unpictured, out, make_env)
    same_bytes(finished, out)


def test_what_cannot_be_pictured_is_refused(tmp_path: Path, unpictured: Path, finished: Path, refuses: Refuses) -> None:
    assert "has images already" in refuses(DatasetError, lambda: add_pictures(finished, tmp_path / "a", make_env))
    assert "something at the root" in refuses(DatasetError, lambda: add_pictures(unpictured, finished, make_env))
    assert "something at the root" in refuses(DatasetError, lambda: add_pictures(unpictured, unpictured, make_env))

    def changed(options: Any) -> Any:
        return demos_fake_env.make_env(options, code="b")

    assert "other versions: code" in refuses(DatasetError, lambda: add_pictures(unpictured, tmp_path / "b", changed))

    class Elsewhere(demos_fake_env.FakeEnv):
        def camera_parameters(self) -> dict[str, Any]:
            return {**super().camera_parameters(), "width": 9}

    def moved(options: Any) -> Any:
        return Elsewhere(options, delay=0.0, crash=None, hopeless=None, code="a")

    assert "comes out differently" in refuses(DatasetError, lambda: add_pictures(unpictured, tmp_path / "c", moved))


def test_a_replay_shows_itself_where_nothing_was_recorded(tmp_path: Path, unpictured: Path) -> None:
    import av

    assert replay(unpictured, 0, make_env, video=tmp_path / "replay.mp4").agrees(1e-6)
    with av.open(str(tmp_path / "replay.mp4")) as video:
        frame = next(video.decode(video=0))
    assert (frame.width, frame.height) == (64, 64)
