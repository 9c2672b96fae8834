"""Files and edits of docs/extending*.md, applied to a copy of the sources, make a category and a policy."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from toy_demos import REPO_ID, record_toy, toy_world

ROOT = Path(__file__).resolve().parents[1]
PAGE, MECHANISM_PAGE, POLICY_PAGE = (
    ROOT / "docs" / name for name in ("extending.md", "extending_mechanism.md", "extending_policy.md")
)
MOST_PLACES = 8
TESTS = ("tests/helpers", "tests/objects", "tests/mechanisms", "tests/experts")


class Change(NamedTuple):
    """A file that is new, or an insertion into one that is there."""

    kind: str
    path: str
    after: str
    code: str


def changes(*pages: Path) -> list[Change]:
    pattern = r"^<!-- (new|edit): ([\w./]+)(?:, (?:after: (.+?)|at the end))? -->\n```python\n(.*?)^```$"
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    found = re.findall(pattern, text, re.MULTILINE | re.DOTALL)
    return [Change(*each) for each in found]


def apply(change: Change, tree: Path) -> None:
    path = tree / change.path
    if change.kind == "new":
        assert not path.exists()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(change.code, encoding="utf-8")
        return
    text = path.read_text(encoding="utf-8")
    if not change.after:
        path.write_text(f"{text}\n\n{change.code}", encoding="utf-8")
        return
    lines = text.splitlines(keepends=True)
    (line,) = [line for line in lines if line.startswith(change.after)] or [
        line for line in lines if change.after in line
    ]
    path.write_text(text.replace(line, line + change.code), encoding="utf-8")


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    copy = tmp_path_factory.mktemp("extended")
    for name in ("lerobot_adamanip", "envs", "policies", "scripts", "hub_cards", "docs", *TESTS):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "tests/conftest.py", "tests/test_categories.py"):
        shutil.copy(ROOT / name, copy / name)
    for change in changes(PAGE, MECHANISM_PAGE, POLICY_PAGE):
        apply(change, copy)
    return copy


def run(tree: Path, code: str, *arguments: str) -> str:
    return run_python(tree, "-c", code, *arguments)


def run_python(tree: Path, *arguments: str) -> str:
    paths = os.pathsep.join(str(tree / name) for name in ("", "envs", "policies", "my_package", "tests/experts"))
    environment = {**os.environ, "PYTHONPATH": paths}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=tree, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


def test_a_tenth_category_touches_few_places() -> None:
    places = [change.path for change in changes(PAGE)]
    assert len(places) == len(set(places))
    assert 0 < len(places) <= MOST_PLACES
    listed = re.findall(r"^\| \d \| `([^`]+)`", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert listed == places


WITHOUT_A_SIMULATOR = """
import dataclasses
import numpy as np
import lerobot_adamanip, lerobot_env_adamanip
from lerobot.envs.configs import EnvConfig
from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.catalog import get_object, parse_object_selection
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.mechanisms import make_mechanism, rules_of
from lerobot_adamanip.episode.options import EnvironmentOptions

assert lerobot_adamanip.__file__.startswith({tree!r})
for split in ("seen", "unseen", "novel"):
    ids = parse_object_selection("jar", split)
    objects = [get_object(name) for name in ids]
    assert [obj.object_id for obj in objects] == list(ids)
    for preset in rules_of("jar"):
        mechanism = make_mechanism(objects[0], preset)
        state = mechanism.draw(np.random.default_rng(0), {{"direction": 1, "turn_range": 1.5}})
        _, shut = mechanism.step(state, {{"lift": 0.0, "cap": 0.0}})
        _, free = mechanism.step(state, {{"lift": 0.0, "cap": 1.4}})
        assert shut["lift"][1] == 0.0 < free["lift"][1]
parts = {{part.name: part for part in objects[0].parts}}
for kind, hidden in (("adaptive", None), ("static", mechanism.hidden(state))):
    goal = next(make_expert("jar", kind, parts, generator=np.random.default_rng(0), hidden=hidden))
    assert goal.action().shape == (10,)
config = EnvConfig.get_choice_class("adamanip_jar")(direction=-1)
assert config.category == "jar" and config.hidden_overrides == {{"direction": -1}}
assert EnvironmentOptions(category="jar", objects="novel")
assert set(ROLES["jar"].folders) == {{"jar"}}
suite = EnvConfig.get_choice_class("adamanip")
assert "jar" in suite().chosen()
"""


def test_tests_of_every_category_pass_for_the_tenth(tree: Path) -> None:
    files = ("objects/test_every_object.py", "mechanisms/test_every_mechanism.py", "test_categories.py")
    chosen = ("-k", "jar or table_of_rules or counts_add_up", "-m", "not nightly", "-p", "no:cacheprovider", "-q")
    done = run_python(tree, "-m", "pytest", *(f"tests/{name}" for name in files), *chosen)
    assert int(re.findall(r"(\d+) passed", done)[0]) > 12


EDITED_MODULES = """
import importlib, sys
from lerobot_adamanip.catalog import get_object

for name in sys.argv[1:]:
    importlib.import_module(name)
from lerobot_env_adamanip.sim.tasks.categories import TASKS

stand = TASKS["jar"].definition.stand(get_object("jar_000"))
(reach,) = stand.reaches
assert reach.part == "cap" and len(reach.paths) == 2
"""


@pytest.mark.sim
def test_every_edited_module_can_be_imported(tree: Path) -> None:
    paths = [change.path for change in changes(PAGE, MECHANISM_PAGE, POLICY_PAGE)]
    modules = [
        re.sub(r"^(envs|policies|my_package)/|\.py$|/__init__\.py$", "", path).replace("/", ".") for path in paths
    ]
    run(tree, EDITED_MODULES, *(name for name in modules if not name.startswith("tests.")))


OWN_MECHANISM = """
from kinematic import KinematicWorld, adaptive, run, static
from lerobot_adamanip.experts import EXPERTS, Expert, presses
from lerobot_adamanip.mechanisms import RULES, CategoryRules, table

RULES["microwave"] = CategoryRules(table._presses, "not in the paper", "")
EXPERTS["microwave"] = Expert(presses.adaptive, presses.static, presses.SEQUENCE)
for number in (1, 2, 3):
    for make in (adaptive, static):
        world = KinematicWorld("microwave_000", {"presses": number})
        episode = run(world, make(world))
        assert episode.opened > 0.6
        assert episode.failed_pulls() == (number if make is adaptive else 0)
"""


def test_category_mechanism_and_expert_of_the_pages_work_without_a_simulator(tree: Path) -> None:
    run(tree, WITHOUT_A_SIMULATOR.format(tree=str(tree)) + OWN_MECHANISM)


MAKE_THE_PAGE = """
import sys
sys.path.insert(0, "scripts")
import make_category_table
for name in set(make_category_table.CATEGORIES) - {"jar", "door"}:  # the others' rows cost a quarter of a minute
    del make_category_table.CATEGORIES[name]
for path, text in make_category_table.documents().items():
    path.write_text(text)
"""


@pytest.mark.nightly
def test_the_page_of_categories_gets_its_row(tree: Path) -> None:
    run(tree, MAKE_THE_PAGE)
    page = (tree / "docs" / "categories.md").read_text(encoding="utf-8")
    assert "[`jar`](#jar)" in page
    assert "Open the jar." in page


IN_THE_SIMULATOR = """
import numpy as np
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.episode.rollout import rollout
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

env = KeyframeEnv("jar", objects="0:1", num_points=64, image_size=64)
observation, _ = env.reset(seed=5)
hidden = env.hidden_state()
expert = make_expert("jar", "static", env.annotations, generator=np.random.default_rng(0), hidden=hidden)
result = rollout(env, observation, expert)
env.close()
assert result.success, result
"""


@pytest.mark.nightly
@pytest.mark.sim
def test_the_tenth_category_is_opened_in_the_simulator(tree: Path) -> None:
    run(tree, IN_THE_SIMULATOR)


TRAINED_AND_EVALUATED = """
import json, sys
import lerobot_env_adamanip, lerobot_policy_hold_still
from lerobot.scripts import lerobot_eval, lerobot_train

demos, out = sys.argv[1:]
sys.argv = ["lerobot-train", "--policy.type=hold_still", "--policy.device=cpu", "--policy.push_to_hub=false",
            "--dataset.repo_id={repo_id}", "--dataset.root=" + demos, "--batch_size=2", "--num_workers=0", "--steps=2",
            "--save_freq=2", "--env_eval_freq=0", "--output_dir=" + out + "/train"]
lerobot_train.main()
sys.argv = ["lerobot-eval", "--policy.path=" + out + "/train/checkpoints/last/pretrained_model", "--policy.device=cpu",
            "--env.type=adamanip_safe", "--env.objects=0:1", "--env.num_points=160", "--env.episode_length=4",
            "--env.episode_log=" + out + "/log.jsonl", "--eval.n_episodes=1", "--eval.batch_size=1",
            "--output_dir=" + out + "/eval"]
lerobot_eval.main()
(line,) = open(out + "/log.jsonl")
assert json.loads(line)["key_frames"] == 4
"""


@pytest.mark.nightly
@pytest.mark.sim
def test_the_method_of_the_page_is_trained_and_evaluated_by_lerobot(tree: Path, tmp_path: Path) -> None:
    record_toy(tmp_path / "demos", [toy_world("safe_000", 1)], "adaptive")
    run(tree, TRAINED_AND_EVALUATED.format(repo_id=REPO_ID), str(tmp_path / "demos"), str(tmp_path))
