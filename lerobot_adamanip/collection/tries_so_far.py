"""The tries of an episode so far: what an expert that takes over in its midst knows."""

from __future__ import annotations

from collections.abc import Callable

from lerobot_adamanip.contract.keyframes import KeyFrameLabels, Outcome
from lerobot_adamanip.episode.dense import DenseEnvironment, DenseStep
from lerobot_adamanip.episode.rollout import KeyframeEnvironment
from lerobot_adamanip.experts import Belief


class KeyFrameTries:
    """Tries by key frames: each is felt at its end."""

    def __init__(self, env: KeyframeEnvironment) -> None:
        self._env, self._before = env, env.part_positions()
        self.belief, self.latest = Belief(), KeyFrameLabels()

    def end(self, outcome: Outcome | None) -> None:
        """Adds the try of the key frame."""
        env, now, self.latest = self._env, self._env.part_positions(), self._env.labels
        is_stalled = outcome is not Outcome.REACHED
        self.belief = self.belief.after(self.latest, env.joint_names, self._before, now, stalled=is_stalled)
        self._before = now


class DenseTries:
    """Tries at control rate: a try is felt when it ends, or when a key frame ends in it."""

    def __init__(self, env: DenseEnvironment) -> None:
        self._env, self.belief, self.latest = env, Belief(), KeyFrameLabels()
        self._labels, self._before, self._latest = KeyFrameLabels(), env.part_positions(), env.part_positions()

    def after_step(self) -> None:
        """Follows a step."""
        labels = self._env.labels
        if labels.number != self._labels.number:
            self._add(stalled=self._env.is_blocked)
            self._before = self._latest
        self._labels, self._latest = labels, self._env.part_positions()

    def end(self, outcome: Outcome | None) -> None:
        """Adds the present try, if there is one."""
        self.latest = self._labels
        self._add(stalled=outcome is Outcome.STALLED)

    def _add(self, *, stalled: bool) -> None:
        known = self._env.joint_names, self._before, self._latest
        self.belief = self.belief.after(self._labels, *known, stalled=stalled)
        self._labels = KeyFrameLabels()


TriesSoFar = KeyFrameTries | DenseTries
"""``belief``: what the tries say about the mechanism; ``latest``: labels of the key frame that ended last."""


def followed(tries: DenseTries, on_step: Callable[[DenseStep], None]) -> Callable[[DenseStep], None]:
    """Returns ``on_step``, which then also follows the tries."""

    def follow(step: DenseStep) -> None:
        tries.after_step()
        on_step(step)

    return follow
