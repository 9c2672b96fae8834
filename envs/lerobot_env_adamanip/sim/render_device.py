"""Rendering device of this machine, tested once and then read from the user's cache; ray casting if there is none.

A GPU in PyTorch does not imply one in Vulkan, and a broken driver may crash or hang. The test therefore runs in its own
process (`render_probe`). Importing this module does not import the simulator.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import logging
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from lerobot_adamanip.episode.options import CLOUD_SOURCES, RAYCAST, RENDER_BACKENDS
from lerobot_adamanip.util.errors import GET_PICTURES, no_vulkan_device, require_choice
from lerobot_adamanip.util.files import write_atomically

PROBE = "lerobot_env_adamanip.sim.render_probe"
PROBE_SECONDS = 90.0
"""Time limit of a probe [s]. The first image compiles its shaders: 8 s on two slow cores."""
NOTHING = "none"
_NVIDIA = Path("/proc/driver/nvidia/version")
_ETC = Path("/etc")
_CHOSEN_DRIVERS = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")
"""Variables that replace the Vulkan loader's search path if one is set."""
_ENVIRONMENT = ("CUDA_VISIBLE_DEVICES", "NVIDIA_VISIBLE_DEVICES", "VK_ADD_DRIVER_FILES", *_CHOSEN_DRIVERS)
_log = logging.getLogger(__name__)


def resolve_render_backend(wanted: str = "auto") -> str:
    """Returns ``cuda`` or ``cpu``: ``wanted``, or for ``auto`` the GPU if it renders, otherwise the CPU.

    Raises:
        ConfigurationError: the backend does not exist.
    """
    if require_choice("render backend", wanted, RENDER_BACKENDS) != "auto":
        return wanted
    return "cuda" if _has_gpu() and rendering_device() == "cuda" else "cpu"


def resolve_cloud_source(wanted: str) -> str:
    """Returns ``raycast`` or ``render``; falls back to ``render`` if embreex is not installed."""
    require_choice("source of clouds", wanted, CLOUD_SOURCES)
    if wanted == "raycast" and importlib.util.find_spec("embreex") is None:
        _warn_once("embreex is not installed, so clouds are rendered, some six times slower: pip install embreex")
        return "render"
    return wanted


_warn_once = functools.cache(_log.warning)


def can_render() -> bool:
    """Returns whether this machine renders; see `rendering_device`."""
    return rendering_device() != NOTHING


def observes_images(wanted: bool | None, source: str) -> bool:
    """Returns whether observations include images of a source, see `IMAGE_SOURCES`.

    None means if the source works on this machine, with a warning if not: ray casting always does.

    Raises:
        SimulatorError: rendered images are requested, but this machine cannot render.
    """
    if wanted is False or source == RAYCAST or can_render():
        return wanted is not False
    if wanted:
        raise no_vulkan_device("no Vulkan driver, or none that takes a picture")
    _log.warning(
        "Observations hold no pictures: nothing renders here. Policies of clouds do without. A policy that looks at "
        "pictures needs --env.observe_images=true, and --env.image_source=raycast or a renderer: %s.",
        GET_PICTURES,
    )
    return False


def takes_picture(backend: str, command: tuple[str, ...] = (), seconds: float = PROBE_SECONDS) -> bool:
    """Returns whether a device renders an image. Tests it in a process, which may crash and is ended if it hangs."""
    command = command or (sys.executable, "-m", PROBE, backend)
    quiet = subprocess.DEVNULL
    try:
        done = subprocess.run(command, check=False, stdin=quiet, stdout=quiet, stderr=quiet, timeout=seconds)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def rendering_device(probe: Callable[[str], bool] = takes_picture) -> str:
    """Returns the first device that renders, ``cuda`` or ``cpu``, or `NOTHING`. Tested once per set of drivers."""
    if not has_vulkan_driver():
        return NOTHING
    path, key = cache_file(), _cache_key()
    answers = _read(path)
    if key not in answers:
        _log.warning("Testing whether this machine renders; the answer is kept for the next time.")
        backends = ["cuda", "cpu"] if _has_gpu() else ["cpu"]
        answers[key] = next((backend for backend in backends if probe(backend)), NOTHING)
        with contextlib.suppress(OSError):  # without a cache, the next process tests again
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, json.dumps(answers).encode())
    return answers[key]


def has_vulkan_driver() -> bool:
    """Returns whether a Vulkan driver is installed; SAPIEN includes the manifest of NVIDIA's."""
    return bool(vulkan_drivers()) or _NVIDIA.exists()


def vulkan_drivers() -> tuple[str, ...]:
    """Returns the manifests (``*.json``) of installed drivers with their times, from the Vulkan loader's folders."""
    folders = [
        *_paths("XDG_CONFIG_DIRS", "/etc/xdg"),
        _ETC,
        Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share"),
        *_paths("XDG_DATA_DIRS", "/usr/local/share:/usr/share"),
    ]
    places = [folder / "vulkan/icd.d" for folder in folders]
    chosen = [path for name in _CHOSEN_DRIVERS for path in _paths(name)]
    searched = chosen or [*places, *_paths("VK_ADD_DRIVER_FILES")]
    manifests = [file for path in searched for file in (sorted(path.glob("*.json")) if path.is_dir() else [path])]
    return tuple(f"{path} {path.stat().st_mtime_ns}" for path in manifests if path.is_file())


def _paths(variable: str, default: str = "") -> list[Path]:
    return [Path(path) for path in (os.environ.get(variable) or default).split(os.pathsep) if path]


def cache_file() -> Path:
    """Returns the cache file, in ``$XDG_CACHE_HOME`` or ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "adamanip" / "render_device.json"


def _has_gpu() -> bool:
    import torch

    return torch.cuda.is_available()


def _cache_key() -> str:
    driver = version = ""
    with contextlib.suppress(OSError):
        driver = _NVIDIA.read_text(encoding="utf-8", errors="replace")
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        version = importlib.metadata.version("sapien")
    parts = (platform.node(), driver, version, *vulkan_drivers(), *(os.environ.get(name, "") for name in _ENVIRONMENT))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def _read(path: Path) -> dict[str, str]:
    try:
        answers = json.loads(path.read_text(encoding="utf-8"))
        return {key: value for key, value in answers.items() if isinstance(value, str)}
    except (OSError, ValueError, AttributeError):
        return {}
