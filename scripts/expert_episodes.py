"""Episodes of scripted experts without rendering: what one is, and how many are run, for check_experts.py."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

from lerobot_adamanip.util.errors import UnreachableError

BATCH = 20
"""Episodes that share a simulator process's start, and are kept at once."""


@dataclass(frozen=True)
class Episode:
    """One to run, and afterwards how it went; ``key_frames`` until success, ``placed`` whether the scene could be."""

    preset: str
    category: str
    kind: str
    split: str
    object_id: str
    seed: int
    placed: bool = True
    success: bool = False
    key_frames: int = 0
    hidden: dict[str, Any] | None = None
    reason: str = ""

    @property
    def identity(self) -> tuple[Any, ...]:
        """What makes it the same episode as another."""
        return (self.preset, self.category, self.kind, self.split, self.object_id, self.seed)


class BlindEnvironment:
    """What `rollout` needs of a `KeyframeEnvironment`, on a task that is never looked at: no rendering, no clouds."""

    def __init__(self, task: Any, max_key_frames: int) -> None:
        self._task, self.max_key_frames = task, max_key_frames
        self.opened_after = 0
        """Key frames until success; 0 without."""
        self._count = 0

    @property
    def feedback(self) -> Any:
        """What was felt after the latest key frame."""
        return self._task.feedback

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Drives the arm to one key frame; the episode goes on past success."""
        self._task.execute(action)
        self._count += 1
        if not self.opened_after and self._task.succeeded():
            self.opened_after = self._count
        return {}, 0.0, False, False, {"is_success": bool(self.opened_after)}


def run_batch(episodes: list[Episode]) -> list[Episode]:
    """Runs episodes of one preset and category one after the other in one simulator."""
    warnings.filterwarnings("ignore")
    from lerobot_env_adamanip.keyframe_env import make_task

    task = make_task(episodes[0].category, mechanism_rules=episodes[0].preset)
    try:
        return [_run(task, episode) for episode in episodes]
    finally:
        task.close()


def _run(task: Any, episode: Episode) -> Episode:
    import numpy as np

    from lerobot_adamanip.contract.schema import MAX_KEY_FRAMES
    from lerobot_adamanip.episode.rollout import rollout
    from lerobot_adamanip.experts import make_expert

    try:
        task.reset(seed=episode.seed, options={"object_id": episode.object_id, "reconfigure": True})
    except UnreachableError as error:
        return replace(episode, placed=False, reason=str(error).splitlines()[0])
    hidden, env = task.hidden_state(), BlindEnvironment(task, MAX_KEY_FRAMES)
    expert = make_expert(
        episode.category,
        episode.kind,
        task.placement.annotations,
        generator=np.random.default_rng(episode.seed),
        hidden=hidden if episode.kind == "static" else None,
        mechanism_rules=episode.preset,
        feedback=task.feedback,
    )
    result = rollout(env, {}, expert)  # type: ignore[arg-type]
    where = {name: round(position, 3) for name, position in task.joint_positions().items()}
    reason = "" if result.success else f"{result.reason}; joints {where}"
    return replace(episode, success=result.success, key_frames=env.opened_after, hidden=hidden, reason=reason)


def batches(episodes: Iterable[Episode]) -> list[list[Episode]]:
    """Groups episodes that can share a simulator."""
    groups: dict[tuple[str, str], list[Episode]] = {}
    for episode in episodes:
        groups.setdefault((episode.preset, episode.category), []).append(episode)
    return [group[start : start + BATCH] for group in groups.values() for start in range(0, len(group), BATCH)]


def run_all(episodes: list[Episode], workers: int, keep: Callable[[list[Episode]], None]) -> None:
    """Runs episodes in ``workers`` processes; ``keep`` is given every batch that has ended."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        try:
            for future in as_completed([pool.submit(run_batch, batch) for batch in batches(episodes)]):
                keep(future.result())
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
