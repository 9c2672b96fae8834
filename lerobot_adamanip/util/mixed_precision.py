"""What a machine can do in half precision, found out in a process of its own.

A CPU may advertise bfloat16 and yet fail to run it (in a virtual machine that hides part of its instructions), with an
error or by ending the process, so a CPU's flags say too little.
"""

from __future__ import annotations

import functools
import subprocess
import sys

from lerobot_adamanip.util.errors import ConfigurationError

PROBE_TIMEOUT_S = 120.0


def _train_a_little(device: str) -> None:
    """One step of what policies consist of, under torch's autocast: whatever it raises, or ends, is the answer.

    Large enough that torch takes oneDNN's kernels, as it does in a training.
    """
    import torch
    from torch import nn

    encoder = (nn.Linear(64, 128), nn.LayerNorm(128), nn.ReLU(), nn.Unflatten(1, (32, 4)))
    down = (nn.Conv1d(32, 64, 3, padding=1), nn.GroupNorm(8, 64), nn.Mish(), nn.Conv1d(64, 64, 3, 2, 1))
    up = (nn.Conv1d(64, 64, 1), nn.ConvTranspose1d(64, 32, 4, 2, 1), nn.Flatten(), nn.Linear(128, 16))
    net = nn.Sequential(*encoder, *down, *up).to(device)
    with torch.autocast(device):
        loss = net(torch.rand(64, 64, device=device)).square().mean()
    loss.backward()
    if not torch.isfinite(loss):
        raise RuntimeError(f"a loss of {loss.item()}")


@functools.cache
def mixed_precision_problem(device: str) -> str | None:
    """Returns what goes wrong when ``device`` (``cpu``, ``cuda``) trains in half precision; None if nothing does.

    Takes as long as importing torch; the answer is kept for the process.
    """
    command = [sys.executable, "-m", "lerobot_adamanip.util.mixed_precision", device]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return f"no answer within {PROBE_TIMEOUT_S:.0f} s"
    if done.returncode == 0:
        return None
    if done.returncode < 0:
        return f"the process ended with signal {-done.returncode}"
    return (done.stderr.strip().splitlines() or ["no message"])[-1]


def require_mixed_precision(device: str) -> None:
    """Raises `ConfigurationError` if ``device`` (``cpu``, ``cuda:0``) cannot train or act in half precision."""
    problem = mixed_precision_problem(device.partition(":")[0])
    if problem is not None:
        raise ConfigurationError(
            "This machine cannot run mixed precision.",
            got=f"use_amp=true on {device}: {problem}",
            allowed="a device that runs bfloat16 or float16",
            hint="--policy.use_amp=false",
        )


if __name__ == "__main__":
    _train_a_little(sys.argv[1])
