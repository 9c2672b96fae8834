"""Patch: notify robots and teleoperators when an episode begins and ends.

Changes:
    ``record_loop`` of `lerobot.scripts.lerobot_record`, which runs once per episode and once per pause between
    episodes. It gets a wrapper; its own code stays.
Why:
    LeRobot does not notify a robot when an episode begins. The twin must reset its scene. A teleoperator must start
    from the robot's current pose, and the scripted one must end the episode.
Without it:
    The twin keeps its scene between episodes, no teleoperator ends one, and only the clutch anchors goals.
Upstream:
    https://github.com/huggingface/lerobot/pull/4173 (closed) would let a caller pass the events; for robots none filed.
Needed for:
    0.6.1 and main of 2026-08-23, tested with both.
Guard:
    ``record`` calls the loop by its global name, and the loop takes ``robot``, ``events`` and ``dataset``.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, MutableMapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from lerobot_adamanip.hardware.robot_registry import ROBOTS
from lerobot_adamanip.lerobot_patches.support import UnsupportedError, loaded, replace

RECORDER = "lerobot.scripts.lerobot_record"
LOOP = "record_loop"
_running: list[MutableMapping[str, Any]] = []


@runtime_checkable
class EpisodicRobot(Protocol):
    """A robot that is notified of episodes, e.g. a twin that resets its scene."""

    def begin_episode(self, index: int) -> None:
        """Prepares episode ``index`` of the dataset. Called before its first observation."""

    def end_episode(self, index: int, root: Path) -> None:
        """Finishes episode ``index`` after its last action. ``root`` is the dataset folder."""

    @property
    def resets_itself(self) -> bool:
        """Whether the robot resets its scene itself. Then no pause between episodes is needed."""


def end_episode() -> bool:
    """Ends the episode being recorded in this process, like the operator's key. Returns False if there is none."""
    for events in _running:
        events["exit_early"] = True
    return bool(_running)


def undecorated(loop: Callable[..., Any]) -> Callable[..., Any]:
    """Returns the function that a decorator wraps. LeRobot's decorator only keeps it in a closure, as ``func``."""
    held = inspect.getclosurevars(loop).nonlocals.get("func") if inspect.isfunction(loop) else None
    return undecorated(held) if callable(held) else inspect.unwrap(loop)


def apply() -> None:
    """Applies the patch. Raises `UnsupportedError` for a recorder with another loop."""
    module = loaded(RECORDER)
    stock, record = getattr(module, LOOP, None), getattr(module, "record", None)
    if not callable(stock) or not callable(record) or LOOP not in undecorated(record).__code__.co_names:
        raise UnsupportedError(f"its recorder does not call {LOOP}")
    if missing := {"robot", "events", "dataset"} - set(inspect.signature(undecorated(stock)).parameters):
        raise UnsupportedError(f"{LOOP} takes no {', '.join(sorted(missing))}")
    replace(module, LOOP, telling(stock))


def telling(stock: Callable[..., Any]) -> Callable[..., Any]:
    """Returns LeRobot's loop with episode events: see `EpisodicRobot` and `RobotSession.episodes`."""
    signature = inspect.signature(undecorated(stock))

    @functools.wraps(stock)
    def record_loop(*args: Any, **kwargs: Any) -> Any:
        arguments = signature.bind(*args, **kwargs).arguments
        robot, dataset, events = arguments["robot"], arguments.get("dataset"), arguments["events"]
        listens = isinstance(robot, EpisodicRobot)
        if dataset is None and listens and robot.resets_itself:
            events["exit_early"] = False  # as LeRobot's loop leaves it
            return None
        if dataset is not None and listens:
            robot.begin_episode(int(dataset.num_episodes))
        session = ROBOTS.find(getattr(robot, "id", None)) or ROBOTS.find()
        if session is not None:
            session.episodes += 1  # teleoperators anchor their goal again
        if dataset is not None:
            _running.append(events)
        try:
            return stock(*args, **kwargs)
        finally:
            if dataset is not None:
                _running.pop()
                if listens:
                    robot.end_episode(int(dataset.num_episodes), Path(dataset.root))

    return record_loop
