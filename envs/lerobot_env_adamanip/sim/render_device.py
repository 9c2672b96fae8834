"""Which device renders: the GPU if it has been seen to, the CPU otherwise.

That PyTorch finds a GPU does not say that Vulkan does: a container for computing often has none of NVIDIA's drivers
for graphics. A picture is the only proof, and a broken driver may crash or hang instead of raising, so the picture is
taken in a process of its own (`render_probe`). The answer is kept in the user's cache for this machine, driver and
SAPIEN. Importing this imports no simulator.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Literal, cast

from lerobot_adamanip.errors import require_choice
from lerobot_adamanip.files import write_atomically

RenderBackend = Literal["cuda", "cpu"]
RENDER_BACKENDS = ("auto", "cuda", "cpu")
MANISKILL_NAMES = {"cuda": "gpu", "cpu": "cpu"}
"""What ManiSkill calls the backends."""
PROBE = "lerobot_env_adamanip.sim.render_probe"
PROBE_SECONDS = 90.0
"""A first picture compiles its shaders: 8 s of two slow cores. What takes this long hangs."""
_DRIVER = Path("/proc/driver/nvidia/version")
_ENVIRONMENT = ("CUDA_VISIBLE_DEVICES", "NVIDIA_VISIBLE_DEVICES", "VK_ICD_FILENAMES", "VK_DRIVER_FILES")


def resolve_render_backend(wanted: str = "auto", probe: Callable[[], bool] | None = None) -> RenderBackend:
    """Returns the device that renders.

    Args:
        wanted: ``cuda`` and ``cpu`` are taken at their word; ``auto`` is ``cuda`` if a GPU renders, else ``cpu``.
        probe: tells whether a GPU renders; `gpu_renders`.

    Raises:
        ConfigurationError: there is no such backend.
    """
    if require_choice("render backend", wanted, RENDER_BACKENDS) != "auto":
        return cast(RenderBackend, wanted)
    return "cuda" if (probe or gpu_renders)() else "cpu"


def gpu_renders(run: Callable[[], bool] | None = None) -> bool:
    """Returns whether the GPU renders: from the cache, or by a picture (``run``), whose outcome is then kept."""
    if not _has_gpu():
        return False
    path, key = cache_file(), _key()
    known = _read(path)
    if key in known:
        return known[key]
    answer = (run or _takes_a_picture)()
    _write(path, {**known, key: answer})
    return answer


def cache_file() -> Path:
    """Returns the file that keeps answers: in ``$XDG_CACHE_HOME``, or ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "adamanip" / "render_device.json"


def _has_gpu() -> bool:
    import torch

    return torch.cuda.is_available()


def _takes_a_picture(command: tuple[str, ...] = (), seconds: float = PROBE_SECONDS) -> bool:
    """Runs the probe in a process that may crash, or is ended when it hangs."""
    command = command or (sys.executable, "-m", PROBE, "cuda")
    quiet = subprocess.DEVNULL
    try:
        done = subprocess.run(command, check=False, stdin=quiet, stdout=quiet, stderr=quiet, timeout=seconds)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def _key() -> str:
    try:
        driver = _DRIVER.read_text(encoding="utf-8", errors="replace")
    except OSError:
        driver = ""
    try:
        version = importlib.metadata.version("sapien")
    except importlib.metadata.PackageNotFoundError:
        version = ""
    parts = (platform.node(), driver, version, *(os.environ.get(name, "") for name in _ENVIRONMENT))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def _read(path: Path) -> dict[str, bool]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    if not isinstance(found, dict):
        return {}
    return {key: value for key, value in found.items() if isinstance(value, bool)}


def _write(path: Path, answers: dict[str, bool]) -> None:
    # A cache that cannot be written costs the next process a probe.
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, json.dumps(answers).encode())
