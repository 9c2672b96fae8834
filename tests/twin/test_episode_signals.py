"""Signals of episodes around LeRobot's recording loop."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lerobot_adamanip.hardware.robot_registry import ROBOTS, RobotSession
from lerobot_adamanip.lerobot_patches import episode_signals


class Twin:
    """A robot that notes what it is told."""

    def __init__(self, resets_itself: bool = True) -> None:
        self.id, self.resets_itself = "twin", resets_itself
        self.told: list[Any] = []

    def begin_episode(self, index: int) -> None:
        self.told.append(("begin", index))

    def end_episode(self, index: int, root: Path) -> None:
        self.told.append(("end", index, root.name))


class Dataset:
    num_episodes, root = 7, "recorded"


def loop(robot: Any, events: dict[str, Any], fps: int, dataset: Any = None, control_time_s: int | None = None) -> str:
    if hasattr(robot, "told"):
        robot.told.append("loop")
    if events.get("ends"):
        episode_signals.end_episode()
    return f"{fps}"


@pytest.fixture
def session() -> Iterator[RobotSession]:
    yield ROBOTS.open("twin")
    ROBOTS.close("twin")


def test_a_decorator_that_hides_its_function_hides_nothing(session: RobotSession) -> None:
    """As LeRobot's does."""

    def decorated(func: Any) -> Any:
        def wrapper(*args: Any, **kwargs: Any) -> Any:
            return func(*args, **kwargs)

        return wrapper

    robot = Twin()
    assert episode_signals.undecorated(decorated(loop)) is loop
    episode_signals.telling(decorated(loop))(robot, {}, 30, dataset=Dataset())
    assert robot.told[0] == ("begin", 7)


def test_an_episode_is_begun_and_ended_around_the_loop(session: RobotSession) -> None:
    robot = Twin()
    told = episode_signals.telling(loop)
    assert told(robot=robot, events={}, fps=30, dataset=Dataset()) == "30"
    assert robot.told == [("begin", 7), "loop", ("end", 7, "recorded")]
    assert session.episodes == 1


def test_the_pause_is_left_out_for_a_scene_that_resets_itself_alone(session: RobotSession) -> None:
    told = episode_signals.telling(loop)
    twin, arm, events = Twin(), Twin(resets_itself=False), {"exit_early": True}
    told(twin, events, 30)
    assert twin.told == []
    assert events == {"exit_early": False}
    told(arm, {}, 30)
    assert arm.told == ["loop"]
    assert session.episodes == 1  # whoever integrates a goal starts anew in the pause, too


def test_an_episode_that_fails_is_logged_and_its_error_is_seen(session: RobotSession) -> None:
    def fails(robot: Any, events: dict[str, Any], dataset: Any = None) -> None:
        raise ValueError("camera")

    robot = Twin()
    with pytest.raises(ValueError, match="camera"):
        episode_signals.telling(fails)(robot, {}, Dataset())
    assert robot.told == [("begin", 7), ("end", 7, "recorded")]
    assert not episode_signals.end_episode()


def test_a_teleoperator_ends_the_episode_that_is_recorded_and_no_other(session: RobotSession) -> None:
    events: dict[str, Any] = {"ends": True}
    told = episode_signals.telling(loop)
    told(Twin(), events, 30, dataset=Dataset())
    assert events["exit_early"] is True
    events = {"ends": True}
    told(Twin(resets_itself=False), events, 30)
    assert "exit_early" not in events


def test_other_robots_are_recorded_as_before() -> None:
    assert episode_signals.telling(loop)(object(), {}, 30, dataset=Dataset()) == "30"
