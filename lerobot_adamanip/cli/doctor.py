"""`adamanip doctor`: checks installation and rendering, and prints fixes."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import reduce
from importlib import metadata
from operator import and_
from pathlib import Path
from typing import cast

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.version import Version

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.util.account import require_account
from lerobot_adamanip.util.errors import INSTALL_SIM, ConfigurationError

DISTRIBUTION = "lerobot_env_adamanip"
ENV_TYPES = ("adamanip", *(f"adamanip_{name}" for name in CATEGORIES))
POLICY_TYPES = ("dp3_adaptive", "adaafford", "sampling", "vat_mart")
INSTALL = "install the project again: pip install . (in a checkout: make setup)"
PACKAGES = {
    **dict.fromkeys(("lerobot", "torch", "numpy", "gymnasium", "diffusers", "fpsample"), INSTALL),
    **dict.fromkeys(("mani-skill", "sapien", "opencv-python"), INSTALL_SIM),
}
"""Distribution -> install command."""
VULKAN_ADVICE = (
    "run scripts/setup_vulkan.sh of the repository: it installs the driver or says how. Debian, Ubuntu: "
    "mesa-vulkan-drivers >= 24.3 and libvulkan1; NVIDIA: the driver's Vulkan part (in a container "
    "NVIDIA_DRIVER_CAPABILITIES=all)"
)
PROBE_TIMEOUT_S = 180.0
MIN_FREE_GB = 5.0
"""Disk space for a demonstration dataset and a training run with checkpoints and videos [GB]."""


@dataclass(frozen=True)
class CheckResult:
    """Result of one check. Only ``required`` checks determine the exit status."""

    name: str
    ok: bool
    found: str
    advice: str = ""
    required: bool = True


@dataclass
class DoctorCommand:
    """Check this machine for everything that the environments, the datasets and the policies need.

    Exit status 0 if all required checks pass, 1 if not.
    """

    json: bool = False
    """Print {"checks": [{name, ok, required, found, advice}], "ok": bool} instead of the table."""

    def run(self) -> int:
        """Runs all checks. Returns 0 if every required check passes."""
        out, checks = sys.stdout, list[CheckResult]()
        with contextlib.redirect_stdout(sys.stderr):  # imported packages may print, but stdout is for the result
            for check in run_checks():
                checks.append(check)
                if not self.json:  # print at once, since some checks take seconds
                    mark = "ok" if check.ok else "FAIL" if check.required else "note"
                    print(f"{mark:<4}  {check.name:<22}  {check.found}", file=out, flush=True)
        ok = all(check.ok for check in checks if check.required)
        if self.json:
            rows = [dataclasses.asdict(check) | {"advice": "" if check.ok else check.advice} for check in checks]
            print(json.dumps({"checks": rows, "ok": ok}, indent=2))
        else:
            failed = {check.name: check.advice for check in checks if not check.ok}
            for name, advice in failed.items():
                print(f"\n{name}: {advice}")
            pictures = "; this machine renders no pictures, see above" if "SAPIEN renders" in failed else ""
            print(f"\nall required checks passed{pictures}" if ok else "\nrequired checks failed: see above")
        return 0 if ok else 1


def check_python() -> CheckResult:
    """Checks the Python version: LeRobot 0.6 needs 3.12."""
    found = ".".join(map(str, sys.version_info[:3]))
    return CheckResult("Python", sys.version_info >= (3, 12), found, "install Python 3.12 and run make setup")


def check_account() -> CheckResult:
    """Checks the home folder and the user name."""
    try:
        require_account()
    except ConfigurationError as error:
        what, got, _, hint = (line.partition(":")[2].strip() or line for line in str(error).splitlines())
        return CheckResult("Account", False, got, f"{what} Try: {hint}. Then run adamanip doctor again")
    return CheckResult("Account", True, "home folder and user name")


def check_versions() -> Iterator[CheckResult]:
    """Checks installed versions against the ranges of this distribution or, if open, of LeRobot."""
    for name, advice in PACKAGES.items():
        ok, found = _version(name)
        yield CheckResult(name, ok, found, advice)


def _version(name: str) -> tuple[bool, str]:
    """Returns whether a distribution's installed version is in range, and a text with the version."""
    specifier = SpecifierSet()
    for source in ("lerobot", DISTRIBUTION):
        with contextlib.suppress(metadata.PackageNotFoundError):
            requirements = map(Requirement, metadata.requires(source) or [])
            specifier = reduce(and_, (each.specifier for each in requirements if each.name.lower() == name), specifier)
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return False, "not installed"
    fits = specifier.contains(Version(version), prereleases=True)
    return fits, version if fits else f"{version}, wanted {specifier}"


def check_opencv() -> CheckResult:
    """Checks OpenCV: opencv-python and -headless share a folder, so both need the same version below 4.14."""
    advice = "pip install 'opencv-python==4.13.0.92' 'opencv-python-headless==4.13.0.92' --force-reinstall --no-deps"
    try:
        import cv2
    except ImportError as error:
        return CheckResult(
            "cv2", False, f"import failed: {error}", f"{advice}; a missing lib*.so comes with {VULKAN_ADVICE}"
        )
    names = ((each.metadata["Name"], each.version) for each in metadata.distributions())
    versions = {name: version for name, version in names if name.startswith("opencv-python")}
    ok = Version(cv2.__version__) < Version("4.14") and len(set(versions.values())) == 1
    return CheckResult(
        "cv2", ok, f"{cv2.__version__} ({', '.join(f'{k} {v}' for k, v in sorted(versions.items()))})", advice
    )


def check_plugin() -> Iterator[CheckResult]:
    """Checks that LeRobot's plugin discovery finds the environments and the policies."""
    advice = f"LeRobot finds plugins by distribution name: is {DISTRIBUTION} installed in this Python?"
    try:
        from lerobot.configs.policies import PreTrainedConfig
        from lerobot.envs.configs import EnvConfig
        from lerobot.utils.import_utils import register_third_party_plugins

        importlib.import_module(DISTRIBUTION)  # LeRobot only logs an error here
        register_third_party_plugins()
    except Exception as error:
        yield CheckResult("LeRobot plugin", False, f"import failed: {type(error).__name__}: {error}", advice)
        return
    for option, names, choices in (
        ("--env.type", ENV_TYPES, EnvConfig.get_known_choices()),
        ("--policy.type", POLICY_TYPES, PreTrainedConfig.get_known_choices()),
    ):
        missing = [name for name in names if name not in choices]
        found = f"not registered: {', '.join(missing)}" if missing else ", ".join(names)
        yield CheckResult(f"LeRobot {option}", not missing, found, advice)


def run_probe(module: str) -> tuple[bool, str]:
    """Runs a module in a separate process. Returns whether it succeeded, and its last line or the error."""
    command = [sys.executable, "-m", module]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return False, f"no answer within {PROBE_TIMEOUT_S:.0f} s"
    if done.returncode < 0:
        return False, f"crashed with signal {-done.returncode}"
    lines = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    return done.returncode == 0, lines[-1] if lines else "no output"


def check_clouds() -> CheckResult:
    """Checks that a ray hits a triangle. Ray-cast clouds need no Vulkan device."""
    advice = f"{INSTALL_SIM}. Without embreex clouds are rendered, six times slower and by a Vulkan device only"
    try:
        import numpy as np
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        return CheckResult("Ray-cast clouds", False, f"import failed: {error}", advice)
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, np.array([[[-1, -1, 2], [1, -1, 2], [0, 1, 2]]], np.float32))
    origin, direction = np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32)
    distance = float(scene.run(origin, direction, query="DISTANCE")[0])
    ok = abs(distance - 2.0) < 1e-6
    found = f"embreex {metadata.version('embreex')}" if ok else f"2 m is {distance}"
    return CheckResult("Ray-cast clouds", ok, found, advice)


def check_rendering() -> CheckResult:
    """Checks that SAPIEN renders a frame. Only pictures need it."""
    from lerobot_env_adamanip.sim.render_device import vulkan_drivers

    ok, answer = run_probe("lerobot_env_adamanip.sim.render_probe")
    drivers = ", ".join(Path(each.split()[0]).name for each in vulkan_drivers()) or "none"
    chosen = [f"{k}={os.environ[k]}" for k in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES") if os.environ.get(k)]
    advice = (
        "clouds, collect --no-images, training and evaluation of dp3_adaptive need no renderer; for pictures, "
        + VULKAN_ADVICE
        + (f". Set here: {', '.join(chosen)}" if chosen else "")
    )
    return CheckResult(
        "SAPIEN renders",
        ok,
        f"on {answer}" if ok else f"{answer}; Vulkan drivers installed: {drivers}",
        advice,
        required=False,
    )


def check_render_backend() -> CheckResult:
    """Checks the device of `--env.render_backend=auto`."""
    from lerobot_env_adamanip.sim.render_device import can_render, resolve_render_backend

    if not can_render():
        found = "none: no pictures here; evaluation videos are drawn without rendering"
        return CheckResult("Render backend", False, found, "see the check SAPIEN renders", required=False)
    return CheckResult("Render backend", True, f"auto is {resolve_render_backend()}", required=False)


def check_franka() -> CheckResult:
    """Checks the driver of a real arm, without importing it, and the kernel."""
    advice = "pip install 'lerobot_env_adamanip[franka]'; for older arms another wheel: docs/robot.md"
    ok, version = _version("franky-control")
    realtime = Path("/sys/kernel/realtime").is_file()
    kernel = "real-time kernel" if realtime else "no real-time kernel, which a real arm needs"
    return CheckResult("Real Franka", ok, f"franky-control {version}; {kernel}", advice, required=False)


def check_cuda() -> CheckResult:
    """Checks for a GPU for training."""
    import torch

    advice = "training on a CPU works for small policies; the paper's policy takes days"
    if not torch.cuda.is_available():
        return CheckResult("CUDA", False, "no GPU that torch can use", advice, required=False)
    return CheckResult(
        "CUDA", True, f"{torch.cuda.get_device_name()} (CUDA {torch.version.cuda})", advice, required=False
    )


def check_video_codecs() -> CheckResult:
    """Checks that a short video is encoded and decoded as in LeRobotDataset."""
    ok, answer = run_probe("lerobot_adamanip.cli.video_probe")
    advice = (
        "pip install --force-reinstall --no-deps av==15.1.0; torchcodec (optional) needs FFmpeg: apt-get install ffmpeg"
    )
    return CheckResult("Video", ok, answer, advice)


def check_hub_cache() -> CheckResult:
    """Checks that the Hugging Face cache, where LeRobot writes datasets and models, is writable."""
    from huggingface_hub.constants import HF_HOME

    try:
        Path(HF_HOME).mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=HF_HOME):
            return CheckResult("Hugging Face cache", True, "writable")
    except OSError as error:
        return CheckResult(
            "Hugging Face cache", False, str(error), "make it writable, or set HF_HOME to a writable folder"
        )


def check_disk() -> CheckResult:
    """Checks free space in the working directory."""
    free_gb = shutil.disk_usage(Path.cwd()).free / 1e9
    advice = f"free some space: datasets and checkpoints need {MIN_FREE_GB:.0f} GB"
    return CheckResult("Free disk", free_gb >= MIN_FREE_GB, f"{free_gb:.0f} GB", advice, required=False)


CHECKS: tuple[Callable[[], CheckResult | Iterator[CheckResult]], ...] = (
    check_python,
    check_account,
    check_versions,
    check_opencv,
    check_plugin,
    check_clouds,
    check_rendering,
    check_render_backend,
    check_franka,
    check_cuda,
    check_video_codecs,
    check_hub_cache,
    check_disk,
)


def run_checks() -> Iterator[CheckResult]:
    """Runs all checks in order. A check that raises counts as failed. Without an account, the rest is skipped."""
    for check in CHECKS:
        try:
            result = check()
            yield from [result] if isinstance(result, CheckResult) else result
            if check is check_account and not cast(CheckResult, result).ok:
                return
        except Exception as error:
            name = check.__name__.removeprefix("check_")
            yield CheckResult(name, False, f"{type(error).__name__}: {error}", "see the message")
