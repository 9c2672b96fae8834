"""Pictures in observations: asked for, refused, or where this machine renders."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import pytest
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env, make_env_config

import lerobot_env_adamanip as plugin
from lerobot_adamanip.util.errors import SimulatorError
from lerobot_env_adamanip import image_options as images

FRONT = "pixels/front"


@pytest.fixture(params=[True, False])
def renders(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether this machine renders, as a probe would say."""
    monkeypatch.setattr(images, "can_render", lambda: request.param)
    return bool(request.param)


def observed(config: EnvConfig) -> bool:
    """Whether the environments that LeRobot makes observe pictures."""
    spaces = set()
    for group in make_env(config, n_envs=1).values():
        space = group[0].single_observation_space
        assert isinstance(space, gym.spaces.Dict)
        spaces.add("pixels" in space.spaces)
        group[0].close()
    (found,) = spaces
    return found


@pytest.mark.parametrize("env_type", ["adamanip_safe", "adamanip"])
def test_left_out_pictures_are_where_something_renders(
    env_type: str, renders: bool, caplog: pytest.LogCaptureFixture
) -> None:
    config = make_env_config(env_type)
    assert observed(config) is renders
    assert (FRONT in config.features) is renders
    said = [each for each in caplog.records if "--env.observe_images=true" in each.message]
    assert [each.levelno for each in said] == ([] if renders else [logging.WARNING])


def test_refused_nothing_is_probed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(images, "can_render", lambda: pytest.fail("somebody has looked for a renderer"))
    assert not observed(make_env_config("adamanip_safe", observe_images=False))
    assert FRONT in make_env_config("adamanip_safe").features  # nothing is probed before environments are made


def test_asked_for_pictures_are_there_or_one_error_says_how_to_get_them(renders: bool) -> None:
    config = make_env_config("adamanip_safe", observe_images=True)
    if renders:
        assert observed(config)
        return
    with pytest.raises(SimulatorError, match=r"(?s)no Vulkan device.*try:.*--env.observe_images=false"):
        observed(config)


@pytest.mark.parametrize("main", [None, SimpleNamespace(), SimpleNamespace(__spec__=None)])
def test_the_plugin_loads_in_an_interpreter_without_a_main_module(
    main: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    if main is None:
        monkeypatch.delitem(sys.modules, "__main__")
    else:
        monkeypatch.setitem(sys.modules, "__main__", main)
    exec(Path(plugin.__file__).read_text(encoding="utf-8"), {"__name__": plugin.__name__})
