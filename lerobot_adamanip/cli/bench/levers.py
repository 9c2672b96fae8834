"""What makes training faster, each measured against the plain way in the same run: plain and fast in turns."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.optim.optimizers import AdamWConfig

from lerobot_adamanip.cli.bench.learning import enough_points, make_policy, synchronise
from lerobot_adamanip.cli.bench.timing import compare_ms
from lerobot_adamanip.contract.schema import POINT_CLOUD

LEAST_REPEATS = 5


@contextmanager
def plain_gradients() -> Iterator[None]:
    """Inside, encoders send gradients through all points."""
    from lerobot_policy_adamanip.common.encoders import PointNetEncoder

    PointNetEncoder.winners_only = False
    try:
        yield
    finally:
        PointNetEncoder.winners_only = True


class Steps:
    """A policy in training, whose steps are taken with or without each lever.

    Args:
        root: folder of a dataset.
        preset: of the policy.
        batch_size: of a step.
        device: of the policy.
    """

    def __init__(self, root: Path, preset: str, *, batch_size: int, device: str) -> None:
        self.policy, self.before, _, self.dataset = make_policy(root, preset, device=device)
        self.policy.train()
        self.device, self._size, self._rng = device, batch_size, np.random.default_rng(0)
        fused = self.policy.config.get_optimizer_preset()
        values = {name: getattr(fused, name) for name in ("lr", "betas", "eps", "weight_decay")}
        plain = AdamWConfig(**values)
        self.optimizers = {True: self._built(fused), False: self._built(plain)}

    def _built(self, config: AdamWConfig) -> torch.optim.Optimizer:
        optimizer = config.build(self.policy.get_optim_params())
        assert isinstance(optimizer, torch.optim.Optimizer)
        return optimizer

    def batch(self, *, at_once: bool) -> dict[str, Any]:
        """A random batch, read at once or one by one."""
        indices = self._rng.integers(len(self.dataset), size=self._size).tolist()
        items = self.dataset.__getitems__(indices) if at_once else [self.dataset[index] for index in indices]
        batch: dict[str, Any] = torch.utils.data.default_collate(items)
        return batch

    def prepared(self, *, at_once: bool) -> dict[str, Any]:
        """A batch as `forward` is given it."""
        batch = self.batch(at_once=at_once)
        batch[POINT_CLOUD] = enough_points(batch[POINT_CLOUD], self.policy.config.num_points)
        return dict(self.before(batch))

    def learn(self, batch: dict[str, Any]) -> None:
        """Loss and gradients."""
        self.policy.forward(batch)[0].backward()
        synchronise(self.device)

    def move(self, *, fused: bool) -> None:
        """What follows the gradients, as lerobot-train does it."""
        torch.nn.utils.clip_grad_norm_(self.policy.parameters(), 10.0)
        self.optimizers[fused].step()
        self.optimizers[fused].zero_grad()
        self.policy.update()
        synchronise(self.device)

    def step(self, *, fast: bool) -> None:
        """A whole step, with every lever or with none."""
        batch = self.prepared(at_once=fast)
        if fast:
            self.learn(batch)
        else:
            with plain_gradients():
                self.learn(batch)
        self.move(fused=fast)


def levers(root: Path, preset: str, *, batch_size: int, repeats: int, device: str) -> dict[str, Any]:
    """Returns plain_ms, ms and speedup of each lever and of the whole step; and the cores a training keeps busy.

    Busy is processor time by wall time, in which OpenMP's threads that wait for the next loop count as busy.
    """
    steps, repeats = Steps(root, preset, batch_size=batch_size, device=device), max(LEAST_REPEATS, repeats)
    ready = steps.prepared(at_once=True)

    def plainly() -> None:
        with plain_gradients():
            steps.learn(ready)

    steps.learn(ready)  # gradients for the optimizers to take
    stepped = {fused: (lambda fused=fused: _stepped(steps, fused)) for fused in (True, False)}
    result: dict[str, Any] = {
        "batch": compare_ms(lambda: steps.batch(at_once=False), lambda: steps.batch(at_once=True), repeats),
        "optimizer": compare_ms(stepped[False], stepped[True], repeats),
        "gradients": compare_ms(plainly, lambda: steps.learn(ready), repeats),
        "step": compare_ms(lambda: steps.step(fast=False), lambda: steps.step(fast=True), repeats),
    }
    result["busy_cores"] = busy_cores(lambda: steps.step(fast=True), 2 * repeats)
    return result


def _stepped(steps: Steps, fused: bool) -> None:
    steps.optimizers[fused].step()
    synchronise(steps.device)


def busy_cores(action: Callable[[], object], repeats: int) -> float:
    """Returns this process' time on processors by the time that passed, over some calls."""
    busy, begin = time.process_time(), time.perf_counter()
    for _ in range(repeats):
        action()
    return round((time.process_time() - busy) / (time.perf_counter() - begin), 2)
