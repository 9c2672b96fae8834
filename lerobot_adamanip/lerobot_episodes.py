"""Tells robots and teleoperators that an episode begins or ends, which LeRobot's recorder tells nobody.

`lerobot-record` calls one function per episode and one per pause in between. That function is wrapped, in LeRobot
versions it was tested with; in every other the recorder stays as it is, a warning says so, and an episode is anchored
by hand (clutch) or by a new session.
"""

from __future__ import annotations

import functools
import inspect
import logging
import sys
from collections.abc import Callable, MutableMapping
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol, runtime_checkable

from lerobot_adamanip import lerobot_version
from lerobot_adamanip.hardware.session import BOARD

TESTED = {"0.6.1": "95cc7a877af8ca53"}
"""LeRobot version -> hash of the source of its recorder's loop, for which the wrapper was written and tested."""
RECORDER = "lerobot.scripts.lerobot_record"
LOOP = "record_loop"
_log = logging.getLogger(__name__)
_running: list[MutableMapping[str, Any]] = []


@runtime_checkable
class EpisodicRobot(Protocol):
    """A robot that wants to know of episodes: a twin, whose scene is put up anew."""

    def begin_episode(self, index: int) -> None:
        """Called before the first observation of the episode that becomes number ``index`` of the dataset."""

    def end_episode(self, index: int, root: Path) -> None:
        """Called after its last action; the dataset is the folder ``root``."""

    @property
    def resets_itself(self) -> bool:
        """Whether the pause between episodes, in which a person resets the scene, is not needed."""


def end_episode() -> bool:
    """Ends the episode that is being recorded in this process, as its key does; False if there is none."""
    for events in _running:
        events["exit_early"] = True
    return bool(_running)


def loop_hash(loop: Callable[..., Any]) -> str:
    """Returns a short hash of the source of a loop, that of the function which its decorators wrap."""
    return lerobot_version.source_hash(undecorated(loop))


def undecorated(loop: Callable[..., Any]) -> Callable[..., Any]:
    """Returns the function that a decorator wraps; LeRobot's own does not say which, but holds it as ``func``."""
    held = inspect.getclosurevars(loop).nonlocals.get("func") if inspect.isfunction(loop) else None
    return undecorated(held) if callable(held) else inspect.unwrap(loop)


def apply() -> bool:
    """Wraps the loop of a recorder that is loaded. Idempotent; False where there is none, or none that was tested."""
    module = _recorder()
    if module is None:
        return False
    stock = getattr(module, LOOP, None)
    if getattr(stock, "tells_episodes", False):
        return True
    if stock is None or not lerobot_version.is_tested(TESTED, lambda: [undecorated(stock)]):
        _log.warning("This LeRobot's recorder is not one that episode events were tested with; nobody is told of them.")
        return False
    setattr(module, LOOP, telling(stock))
    return True


def telling(stock: Callable[..., Any]) -> Callable[..., Any]:
    """Returns LeRobot's loop with events around it: see `EpisodicRobot` and `RobotSession.episodes`."""
    signature = inspect.signature(undecorated(stock))

    @functools.wraps(stock)
    def record_loop(*args: Any, **kwargs: Any) -> Any:
        given = signature.bind(*args, **kwargs).arguments
        robot, dataset, events = given["robot"], given.get("dataset"), given["events"]
        listens = isinstance(robot, EpisodicRobot)
        if dataset is None and listens and robot.resets_itself:
            events["exit_early"] = False  # as LeRobot's loop leaves it
            return None
        if dataset is not None and listens:
            robot.begin_episode(int(dataset.num_episodes))
        _count(robot)
        if dataset is not None:
            _running.append(events)
        try:
            return stock(*args, **kwargs)
        finally:
            if dataset is not None:
                _running.pop()
                if listens:
                    robot.end_episode(int(dataset.num_episodes), Path(dataset.root))

    record_loop.tells_episodes = True  # type: ignore[attr-defined]
    return record_loop


def _count(robot: Any) -> None:
    """Whoever integrates a goal for this robot starts anew."""
    session = BOARD.find(getattr(robot, "id", None)) or BOARD.find()
    if session is not None:
        session.episodes += 1


def _recorder() -> ModuleType | None:
    """The recorder's module, also where it is run as a program."""
    main = sys.modules.get("__main__")
    spec = getattr(main, "__spec__", None)
    if spec is not None and spec.name == RECORDER:
        return main
    return sys.modules.get(RECORDER)
