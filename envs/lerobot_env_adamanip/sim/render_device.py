"""Which device renders: the GPU if it has been seen to, the CPU otherwise.

That PyTorch finds a GPU does not say that Vulkan does: a container for computing often has none of NVIDIA's drivers
for graphics. A picture is the only proof, and a broken driver may crash or hang instead of raising, so the picture is
taken in a process of its own (`render_probe`). The answer is kept in the user's cache for this machine, driver and
SAPIEN. Importing this imports no simulator.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import json
import logging
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Literal, cast

from lerobot_adamanip.util.errors import require_choice
from lerobot_adamanip.util.files import write_atomically

RenderBackend = Literal["cuda", "cpu"]
RENDER_BACKENDS = ("auto", "cuda", "cpu")
MANISKILL_NAMES = {"cuda": "gpu", "cpu": "cpu"}
"""What ManiSkill calls the backends."""
PROBE = "lerobot_env_adamanip.sim.render_probe"
PROBE_SECONDS = 90.0
"""A first picture compiles its shaders: 8 s of two slow cores. What takes this long hangs."""
_DRIVER = Path("/proc/driver/nvidia/version")
_ETC = Path("/etc")
_CHOSEN_DRIVERS = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")
"""Where either names files or folders, the Vulkan loader looks nowhere else."""
_ENVIRONMENT = ("CUDA_VISIBLE_DEVICES", "NVIDIA_VISIBLE_DEVICES", "VK_ADD_DRIVER_FILES", *_CHOSEN_DRIVERS)
_logger = logging.getLogger(__name__)


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


def can_render(run: Callable[[], bool] | None = None) -> bool:
    """Returns whether anything renders here: at once where there is no Vulkan driver, else as `gpu_renders` does."""
    return has_vulkan_driver() and _cached(
        "any " + _key(*vulkan_drivers()), run or functools.partial(_takes_a_picture, backends=("cuda", "cpu"))
    )


def has_vulkan_driver() -> bool:
    """Returns whether a Vulkan driver is installed; SAPIEN brings the manifest of NVIDIA's itself."""
    return bool(vulkan_drivers()) or _DRIVER.exists()


def vulkan_drivers() -> tuple[str, ...]:
    """Returns the installed Vulkan drivers: their manifests (``*.json``) and when each was written.

    Looks where the Vulkan loader does, which alone knows whether they work.
    """
    folders = [
        *(Path(each) for each in _paths("XDG_CONFIG_DIRS", "/etc/xdg")), _ETC,
        Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share"),
        *(Path(each) for each in _paths("XDG_DATA_DIRS", "/usr/local/share:/usr/share")),
    ]  # fmt: skip
    places = [folder / "vulkan/icd.d" for folder in folders]
    chosen = [Path(each) for name in _CHOSEN_DRIVERS for each in _paths(name, "")]
    found = chosen or [*places, *(Path(each) for each in _paths("VK_ADD_DRIVER_FILES", ""))]
    manifests = [path for each in found for path in (sorted(each.glob("*.json")) if each.is_dir() else [each])]
    return tuple(f"{path} {path.stat().st_mtime_ns}" for path in manifests if path.is_file())


def _paths(variable: str, default: str) -> list[str]:
    return [each for each in (os.environ.get(variable) or default).split(os.pathsep) if each]


def gpu_renders(run: Callable[[], bool] | None = None) -> bool:
    """Returns whether the GPU renders: from the cache, or by a picture (``run``), whose outcome is then kept."""
    return _has_gpu() and _cached(_key(), run or _takes_a_picture)


def _cached(key: str, run: Callable[[], bool]) -> bool:
    path = cache_file()
    known = _read(path)
    if key in known:
        return known[key]
    _logger.warning("Testing whether this machine renders; the answer is kept for the next time.")
    answer = run()
    _write(path, {**known, key: answer})
    return answer


def cache_file() -> Path:
    """Returns the file that keeps answers: in ``$XDG_CACHE_HOME``, or ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "adamanip" / "render_device.json"


def _has_gpu() -> bool:
    import torch

    return torch.cuda.is_available()


def _takes_a_picture(
    command: tuple[str, ...] = (), seconds: float = PROBE_SECONDS, backends: tuple[str, ...] = ("cuda",)
) -> bool:
    """Runs the probe in a process that may crash, or is ended when it hangs."""
    command = command or (sys.executable, "-m", PROBE, *backends)
    quiet = subprocess.DEVNULL
    try:
        done = subprocess.run(command, check=False, stdin=quiet, stdout=quiet, stderr=quiet, timeout=seconds)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def _key(*drivers: str) -> str:
    try:
        driver = _DRIVER.read_text(encoding="utf-8", errors="replace")
    except OSError:
        driver = ""
    try:
        version = importlib.metadata.version("sapien")
    except importlib.metadata.PackageNotFoundError:
        version = ""
    parts = (platform.node(), driver, version, *drivers, *(os.environ.get(name, "") for name in _ENVIRONMENT))
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
