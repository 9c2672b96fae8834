"""The device that renders is found once, by a process that may crash or hang; pictures are observed where it is."""

from __future__ import annotations

import logging
import sys
import time
from pathlib import Path

import gymnasium as gym
import pytest
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env, make_env_config

import lerobot_env_adamanip  # noqa: F401  (registers the types)
from lerobot_adamanip.util.errors import ConfigurationError, SimulatorError
from lerobot_env_adamanip.sim import render_device
from lerobot_env_adamanip.sim.render_device import (
    NOTHING,
    cache_file,
    rendering_device,
    resolve_render_backend,
    takes_picture,
    vulkan_drivers,
)

FRONT = "observation.images.front"


@pytest.fixture(autouse=True)
def drivers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A GPU, a cache and a folder of drivers of its own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(render_device, "_has_gpu", lambda: True)
    monkeypatch.setattr(render_device, "_NVIDIA", tmp_path / "no_nvidia")
    monkeypatch.setattr(render_device, "_ETC", tmp_path / "etc")
    for name in ("XDG_CONFIG_DIRS", "XDG_DATA_DIRS", "XDG_DATA_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "share"))
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_ADD_DRIVER_FILES"):
        monkeypatch.delenv(name, raising=False)
    return manifests(tmp_path / "share" / "vulkan" / "icd.d", "lvp.json")


def manifests(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True)
    for name in names:
        (folder / name).write_text("{}")
    return folder


class Probe:
    def __init__(self, *renders: str) -> None:
        self.renders, self.asked = renders, list[str]()

    def __call__(self, backend: str) -> bool:
        self.asked.append(backend)
        return backend in self.renders


def test_a_machine_is_probed_once_and_the_gpu_comes_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for case, (probe, answer, asked) in enumerate(
        [
            (Probe("cuda", "cpu"), "cuda", ["cuda"]),
            (Probe("cpu"), "cpu", ["cuda", "cpu"]),
            (Probe(), NOTHING, ["cuda", "cpu"]),
        ]
    ):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / str(case)))
        assert [rendering_device(probe) for _ in range(3)] == [answer] * 3
        assert probe.asked == asked
        assert resolve_render_backend() == ("cuda" if answer == "cuda" else "cpu")
        assert render_device.can_render() is (answer != NOTHING)
    assert [resolve_render_backend(name) for name in ("cuda", "cpu")] == ["cuda", "cpu"]  # taken at their word
    with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*auto"):
        resolve_render_backend("vulkan")
    monkeypatch.setattr(render_device, "_has_gpu", lambda: False)
    monkeypatch.setattr(render_device, "rendering_device", lambda: pytest.fail("without a GPU nothing is probed"))
    assert resolve_render_backend() == "cpu"


@pytest.mark.parametrize("content", ["", "[1]", '{"x": 3}', "\x00", None])
def test_a_cache_that_cannot_be_read_or_written_costs_a_probe(content: str | None, tmp_path: Path) -> None:
    if content is None:
        (tmp_path / "cache").write_text("")  # where a folder should be
    else:
        cache_file().parent.mkdir(parents=True)
        cache_file().write_text(content)
    probe = Probe("cuda")
    assert rendering_device(probe) == "cuda"
    assert probe.asked == ["cuda"]


def test_another_driver_is_probed_anew_and_no_driver_is_not(drivers: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    probe = Probe("cuda")
    rendering_device(probe)
    (drivers / "other.json").write_text("{}")
    rendering_device(probe)
    render_device._NVIDIA.write_text("570")
    rendering_device(probe)
    assert len(probe.asked) == 3
    render_device._NVIDIA.unlink()
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(name, "/dev/null")  # overrides what is installed
        assert rendering_device(probe) == NOTHING
        monkeypatch.delenv(name)
    assert len(probe.asked) == 3


def test_drivers_are_found_where_the_loader_finds_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = manifests(tmp_path / "chosen", "a.json", "b.json", "c.txt")
    monkeypatch.setenv("XDG_DATA_DIRS", str(tmp_path / "none"))
    monkeypatch.setenv("XDG_CONFIG_DIRS", str(tmp_path / "none"))
    monkeypatch.setenv("VK_ADD_DRIVER_FILES", str(chosen))
    manifests(tmp_path / "etc" / "vulkan" / "icd.d", "etc.json")
    assert [Path(each.split()[0]).name for each in vulkan_drivers()] == ["etc.json", "lvp.json", "a.json", "b.json"]
    monkeypatch.setenv("VK_DRIVER_FILES", str(chosen / "a.json"))
    assert [Path(each.split()[0]).name for each in vulkan_drivers()] == ["a.json"]


def test_a_probe_that_crashes_or_hangs_takes_no_picture() -> None:
    began = time.monotonic()
    for code in ("import os; os.abort()", "import time; time.sleep(60)", "raise RuntimeError"):
        assert not takes_picture("cpu", (sys.executable, "-c", code), seconds=1.0)
    assert time.monotonic() - began < 30.0
    assert takes_picture("cpu", (sys.executable, "-c", ""), seconds=60.0)


def observed(config: EnvConfig) -> bool:
    """Whether the environments that LeRobot makes observe pictures."""
    (group, *_) = make_env(config, n_envs=1).values()
    space = group[0].single_observation_space
    assert isinstance(space, gym.spaces.Dict)
    return "pixels" in space.spaces


@pytest.mark.parametrize("renders", [True, False])
@pytest.mark.parametrize("env_type", ["adamanip_safe", "adamanip"])
def test_pictures_are_observed_where_something_renders(
    env_type: str, renders: bool, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(render_device, "can_render", lambda: renders)
    config = make_env_config(env_type)
    assert FRONT in config.features  # nothing is probed before environments are made
    assert observed(config) is renders
    assert (FRONT in config.features) is renders
    said = [each for each in caplog.records if "--env.observe_images=true" in each.message]
    assert [each.levelno for each in said] == ([] if renders else [logging.WARNING])
    wanted = make_env_config(env_type, observe_images=True)
    if renders:
        assert observed(wanted)
    else:
        with pytest.raises(SimulatorError, match=r"(?s)no Vulkan device.*try:.*--env.observe_images=false"):
            observed(wanted)
    monkeypatch.setattr(render_device, "can_render", lambda: pytest.fail("refused pictures need no renderer"))
    assert not observed(make_env_config(env_type, observe_images=False))
