"""The factory for LeRobot's environment server: its worlds are what the server's backend asks for."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from documents import blocks

from lerobot_adamanip import __version__
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.episode.options import TIME_LIMIT
from lerobot_adamanip.evaluation.record import read_log
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.environment_server import create_adamanip_envs

ROOT = Path(__file__).resolve().parents[2]
PAGE = "docs/upstream/environment_server.md"


@pytest.mark.sim
@pytest.mark.usefixtures("no_vulkan")
def test_a_world_is_served_where_nothing_renders(tmp_path: Path) -> None:
    """One episode of two key frames, as the smoke test of the server's continuous integration runs it."""
    log = tmp_path / "served.jsonl"
    sizes = {"num_points": 64, "image_size": 48, "max_key_frames": 2, "split": "validation", "hints": 1.0}
    (function,) = create_adamanip_envs("safe", 1, list, episode_log=str(log), **sizes)["safe"][0]
    env = function()
    assert env.task == env.task_description == CATEGORIES["safe"].instruction
    assert env._max_episode_steps == 2
    observation, _ = env.reset(seed=5)
    assert env.task == env.task_description != CATEGORIES["safe"].instruction, "with the hint"
    assert env.observation_space.contains(observation)
    assert observation["point_cloud"].shape == (192,)
    assert len(np.unique(observation["pixels"]["preview"])) > 20, "a shaded picture, not a black one"
    ends = [env.step(observation["agent_pos"][: schema.ACTION_DIM])[2:] for _ in range(2)]
    assert ends == [
        (False, False, {"is_success": False, "limit": "", "goal_clipped": False}),
        (False, True, {"is_success": False, "limit": TIME_LIMIT, "goal_clipped": False}),
    ]
    env.close()
    (record,) = read_log(log)  # what the server does not pass on: hidden state, tries, outcomes
    assert (record.given_seed, record.key_frames, record.split) == (5, 2, "validation")
    assert set(record.hidden_state) == {"direction", "knob_range", "locked"}


def test_every_category_is_a_task_with_scenes_of_its_own() -> None:
    found = create_adamanip_envs("all", 2, list, num_points=32)
    assert list(found) == list(CATEGORIES)
    assert {len(functions) for tasks in found.values() for functions in tasks.values()} == {2}
    worlds = {name: found[name][0][0]() for name in ("door", "lamp")}
    offsets = {name: world.unwrapped.options.seed_offset for name, world in worlds.items()}
    assert offsets == {"door": 700_000, "lamp": 800_000}
    (alone,) = create_adamanip_envs("door", 1, list)["door"][0]
    assert alone().unwrapped.options.seed_offset == 0


def test_worlds_of_one_session_are_one_evaluation(tmp_path: Path) -> None:
    found = create_adamanip_envs("pen, lamp", 2, list, episode_log=str(tmp_path / "log.jsonl"))
    worlds = [function() for tasks in found.values() for function in tasks[0]]
    assert len({world.unwrapped.options.run_id for world in worlds}) == 1
    assert None not in {world.unwrapped.options.run_id for world in worlds}


@pytest.mark.parametrize(
    "wrong",
    [
        {"task": "teapot"}, {"task": ""}, {"points": 3}, {"split": "holdout"}, {"control": "dense"},
        {"repeats": 3, "n_envs": 2},
    ],
)  # fmt: skip
def test_what_there_is_not_is_refused_before_a_world_is_made(refuses: Any, wrong: dict[str, Any]) -> None:
    refuses(ConfigurationError, lambda: create_adamanip_envs(**{"task": "safe", "n_envs": 1, "env_cls": list, **wrong}))


def test_an_image_without_the_rest_of_lerobot_can_serve() -> None:
    """Server images hold LeRobot's server, and neither its policies nor its own environments."""
    code = """
import sys
sys.modules["lerobot"] = None
from lerobot_env_adamanip.environment_server import create_adamanip_envs
create_adamanip_envs("all", 1, list)
print("torch" in sys.modules, "sapien" in sys.modules)
"""
    environment = {"ADAMANIP_NO_PLUGIN": "1", "PYTHONPATH": f"{ROOT}:{ROOT / 'envs'}:{ROOT / 'policies'}"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["False", "False"], done.stderr


def on_the_page(language: str) -> list[str]:
    return [block.code for block in blocks(language) if block.document == PAGE]


def test_the_files_on_the_page_fit_each_other_and_the_contract() -> None:
    simulator, profile, (benchmark,) = map(yaml.safe_load, on_the_page("yaml"))
    sim = simulator["sim"]
    for names in (sim, profile):
        assert tuple(names["state_names"]) == schema.STATE_NAMES
        assert tuple(names["action_names"]) == schema.POSE_NAMES
    assert (sim["fps"], sim["gripper_indices"]) == (schema.FPS, [schema.GRIPPER_DIM])
    assert (sim["control"], sim["semantics"]) == (profile["control"], profile["semantics"])
    assert benchmark["task"] in create_adamanip_envs(sim["task"], benchmark["batch_size"], list, **sim["kwargs"])


def test_the_image_has_what_the_simulator_needs_in_the_tested_versions() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = {re.split(r"[<=>]", one)[0].replace("-", "_") for one in declared["optional-dependencies"]["sim"]}
    (dockerfile,) = on_the_page("dockerfile")
    installed = set(re.findall(r"[\w-]+==[\w.]+", dockerfile))
    package = {one for one in installed if one.startswith(declared["name"])}
    assert package == {f"{declared['name']}=={'.'.join(__version__.split('.')[:3])}"}
    assert installed - package <= set((ROOT / "constraints.txt").read_text().splitlines())
    assert {one.split("==")[0].replace("-", "_") for one in installed} >= needed | {"torch"}
