"""What `adamanip doctor` looks at: each check is a function that returns one or more `Check`."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

from lerobot_adamanip.contract.categories import CATEGORIES

DISTRIBUTION = "lerobot_env_adamanip"
ENV_TYPES = ("adamanip", *(f"adamanip_{name}" for name in CATEGORIES))
POLICY_TYPES = ("dp3_adaptive", "adaafford", "sampling", "vat_mart")
SIM_INSTALL = "pip install 'lerobot_env_adamanip[sim]' (in a checkout: make setup)"
VULKAN_ADVICE = (
    "run scripts/setup_vulkan.sh of the repository: it installs the driver or says how. Debian, Ubuntu: "
    "mesa-vulkan-drivers >= 24.3 and libvulkan1; NVIDIA: the driver's Vulkan part (in a container "
    "NVIDIA_DRIVER_CAPABILITIES=all)"
)
PROBE_TIMEOUT_S = 180.0
MIN_FREE_GB = 5.0
"""A demonstration dataset, a training run with checkpoints and its videos."""


@dataclass(frozen=True)
class Check:
    """One finding. ``required`` ones decide the exit status."""

    name: str
    ok: bool
    found: str
    advice: str = ""
    required: bool = True


def check_python() -> Check:
    """LeRobot 0.6 needs Python 3.12."""
    found = ".".join(map(str, sys.version_info[:3]))
    return Check("Python", sys.version_info >= (3, 12), found, "install Python 3.12 and run make setup")


def _requirements() -> dict[str, Requirement]:
    """Name -> version range, out of the metadata of this distribution and, for what it leaves open, of LeRobot's."""
    ranges: dict[str, Requirement] = {}
    for source in ("lerobot", DISTRIBUTION):
        try:
            lines = metadata.requires(source) or []
        except metadata.PackageNotFoundError:
            continue
        ranges |= {r.name.lower(): r for r in map(Requirement, lines) if r.specifier}
    return ranges


def check_versions() -> Iterator[Check]:
    """Is each package that matters installed, and in the range asked for?"""
    ranges = _requirements()
    optional = ("mani-skill", "sapien", "opencv-python")
    for name in ("lerobot", "torch", "numpy", "gymnasium", "diffusers", "fpsample", *optional):
        advice = (
            SIM_INSTALL if name in optional else "install the project again: pip install . (in a checkout: make setup)"
        )
        wanted = ranges[name].specifier if name in ranges else None
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            yield Check(name, False, "not installed", advice)
            continue
        fits = wanted is None or wanted.contains(Version(version), prereleases=True)
        yield Check(name, fits, version if fits else f"{version}, wanted {wanted}", advice)


def check_opencv() -> Check:
    """opencv-python and -headless share one folder: what is imported has to be below 4.14, and both the same."""
    advice = "pip install 'opencv-python==4.13.0.92' 'opencv-python-headless==4.13.0.92' --force-reinstall --no-deps"
    try:
        import cv2
    except ImportError as error:
        return Check("cv2", False, f"import failed: {error}", f"{advice}; a missing lib*.so comes with {VULKAN_ADVICE}")
    versions = {
        d.metadata["Name"]: d.version
        for d in metadata.distributions()
        if d.metadata["Name"].startswith("opencv-python")
    }
    ok = Version(cv2.__version__) < Version("4.14") and len(set(versions.values())) == 1
    return Check("cv2", ok, f"{cv2.__version__} ({', '.join(f'{k} {v}' for k, v in sorted(versions.items()))})", advice)


def check_plugin() -> Iterator[Check]:
    """Does LeRobot's own discovery find the environments and the policy?"""
    advice = f"LeRobot finds plugins by distribution name: is {DISTRIBUTION} installed in this Python?"
    try:
        from lerobot.configs.policies import PreTrainedConfig
        from lerobot.envs.configs import EnvConfig
        from lerobot.utils.import_utils import register_third_party_plugins

        importlib.import_module(DISTRIBUTION)  # LeRobot only logs what goes wrong here
        register_third_party_plugins()
    except Exception as error:
        yield Check("LeRobot plugin", False, f"import failed: {type(error).__name__}: {error}", advice)
        return
    known = (
        ("--env.type", ENV_TYPES, EnvConfig.get_known_choices()),
        ("--policy.type", POLICY_TYPES, PreTrainedConfig.get_known_choices()),
    )
    for option, wanted, choices in known:
        missing = [name for name in wanted if name not in choices]
        found = f"not registered: {', '.join(missing)}" if missing else ", ".join(wanted)
        yield Check(f"LeRobot {option}", not missing, found, advice)


def run_probe(module: str) -> tuple[bool, str]:
    """Runs a module of ours in a process of its own; (success, its last line of output or what went wrong)."""
    command = [sys.executable, "-m", module]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return False, f"no answer within {PROBE_TIMEOUT_S:.0f} s"
    if done.returncode < 0:
        return False, f"crashed with signal {-done.returncode}"
    lines = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    return done.returncode == 0, lines[-1] if lines else "no output"


def check_vulkan() -> Check:
    """Which Vulkan devices and driver versions there are. SAPIEN brings its own loader, so this informs only."""
    ok, answer = run_probe("lerobot_adamanip.cli.doctor.vulkan_devices")
    if not ok:
        return Check("Vulkan device", False, answer, VULKAN_ADVICE, required=False)
    devices = json.loads(answer)
    found = "; ".join(f"{d['name']}, {d['type']}, {d['driver']}" for d in devices) or "none"
    return Check("Vulkan device", bool(devices), found, VULKAN_ADVICE, required=False)


def check_clouds() -> Check:
    """A ray cast at a triangle: clouds need no Vulkan device."""
    advice = f"{SIM_INSTALL}. Without embreex clouds are rendered, ten times slower and by a Vulkan device only"
    try:
        import numpy as np
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        return Check("Ray-cast clouds", False, f"import failed: {error}", advice)
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, np.array([[[-1, -1, 2], [1, -1, 2], [0, 1, 2]]], np.float32))
    origin, direction = np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32)
    distance = float(scene.run(origin, direction, query="DISTANCE")[0])
    ok = abs(distance - 2.0) < 1e-6
    return Check(
        "Ray-cast clouds", ok, f"embreex {metadata.version('embreex')}" if ok else f"2 m is {distance}", advice
    )


def check_rendering() -> Check:
    """A frame rendered by SAPIEN: for pictures alone, so not required."""
    ok, answer = run_probe("lerobot_env_adamanip.sim.render_probe")
    overridden = [f"{k}={os.environ[k]}" for k in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES") if os.environ.get(k)]
    without = "clouds, collect --no-images, training and evaluation of dp3_adaptive do without; for pictures, "
    advice = without + (f"{VULKAN_ADVICE}. Set here: {', '.join(overridden)}" if overridden else VULKAN_ADVICE)
    return Check("SAPIEN renders", ok, f"on {answer}" if ok else answer, advice, required=False)


def check_render_backend() -> Check:
    """Which device `--env.render_backend=auto` takes: the probe's answer, so what environments do."""
    from lerobot_env_adamanip.sim.render_device import can_render, resolve_render_backend

    if not can_render():
        found = "none: no pictures here; videos of evaluations are drawn without"
        return Check("Render backend", False, found, "see what SAPIEN renders", required=False)
    return Check("Render backend", True, f"auto is {resolve_render_backend()}", required=False)


def check_franka() -> Check:
    """What drives a real arm, without importing it; and the firmware that the wheel on the index speaks to."""
    advice = "pip install 'lerobot_env_adamanip[franka]'; for older arms another wheel: docs/robot.md"
    wanted = _requirements().get("franky-control")
    try:
        version = metadata.version("franky-control")
    except metadata.PackageNotFoundError:
        return Check("Real Franka", False, "franky-control is not installed", advice, required=False)
    fits = wanted is None or wanted.specifier.contains(Version(version), prereleases=True)
    found = f"franky-control {version}" if fits else f"franky-control {version}, wanted {wanted.specifier}"  # type: ignore[union-attr]
    realtime = Path("/sys/kernel/realtime").is_file()
    kernel = "real-time kernel" if realtime else "no real-time kernel, which a real arm needs"
    return Check("Real Franka", fits, f"{found}; {kernel}", advice, required=False)


def check_cuda() -> Check:
    """A GPU for training; not required."""
    import torch

    advice = "training on a CPU works for the small policies; the paper's takes days"
    if not torch.cuda.is_available():
        return Check("CUDA", False, "no GPU that torch can use", advice, required=False)
    return Check("CUDA", True, f"{torch.cuda.get_device_name()} (CUDA {torch.version.cuda})", advice, required=False)


def check_mixed_precision() -> Check:
    """Can what trains here train in half precision? Found out by doing it."""
    import torch

    from lerobot_adamanip.util.mixed_precision import mixed_precision_problem

    device = "cuda" if torch.cuda.is_available() else "cpu"
    problem = mixed_precision_problem(device)
    found = f"{device} trains in it" if problem is None else f"not on {device}: {problem}"
    return Check("Mixed precision", problem is None, found, "train without --policy.use_amp=true", required=False)


def check_disk() -> Check:
    """Free space where one works."""
    free_gb = shutil.disk_usage(Path.cwd()).free / 1e9
    advice = f"free some: datasets and checkpoints want {MIN_FREE_GB:.0f} GB"
    return Check("Free disk", free_gb >= MIN_FREE_GB, f"{free_gb:.0f} GB", advice, required=False)


def check_video() -> Check:
    """A short video written and read the way LeRobotDataset does it."""
    ok, answer = run_probe("lerobot_adamanip.cli.doctor.video_probe")
    advice = (
        "pip install --force-reinstall --no-deps av==15.1.0; torchcodec (optional) needs FFmpeg: apt-get install ffmpeg"
    )
    return Check("Video", ok, answer, advice)


def check_hub_cache() -> Check:
    """LeRobot writes datasets and models below the Hugging Face cache."""
    from huggingface_hub.constants import HF_HOME

    home = Path(HF_HOME)
    try:
        home.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=home):
            return Check("Hugging Face cache", True, "writable")
    except OSError as error:
        return Check("Hugging Face cache", False, str(error), "make it writable, or set HF_HOME to a folder that is")


CHECKS: tuple[Callable[[], Check | Iterator[Check]], ...] = (
    check_python,
    check_versions,
    check_opencv,
    check_plugin,
    check_clouds,
    check_vulkan,
    check_rendering,
    check_render_backend,
    check_franka,
    check_cuda,
    check_mixed_precision,
    check_video,
    check_hub_cache,
    check_disk,
)


def run_checks() -> Iterator[Check]:
    """Every finding in order. A check that breaks is a failed check: the doctor itself never raises."""
    for check in CHECKS:
        try:
            findings = check()
            yield from [findings] if isinstance(findings, Check) else findings
        except Exception as error:
            yield Check(
                check.__name__.removeprefix("check_"), False, f"{type(error).__name__}: {error}", "see the message"
            )
