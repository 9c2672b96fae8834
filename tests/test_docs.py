"""The documents stay true: code runs, commands parse, tables are the code's, links lead somewhere."""

from __future__ import annotations

import ast
import dataclasses
import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest
from doc_data import collect_fake_demos, write_asset_safe
from documents import DOCUMENTS, ROOT, Block, blocks, commands

from lerobot_adamanip.cli.main import COMMANDS, parse_command
from lerobot_adamanip.contract import schema
from lerobot_adamanip.experts import Outcome, Phase

OFTEN = ("docs/python.md", "docs/twin.md")
"""Documents of which the Python blocks run in `make test`; those of the others run every night."""
PROCESSES = "forkserver"
"""What a block has that starts a simulator in each of several processes: it runs at night, too."""


def python_blocks() -> list[Any]:
    """Blocks that run by themselves."""
    found = []
    for block in blocks("python"):
        if not block.mark.startswith(("new: ", "edit: ")):  # tests/test_extending.py has these
            marks = [pytest.mark.sim] * block.mark.startswith("sim")
            marks += [pytest.mark.nightly] * (block.document not in OFTEN or PROCESSES in block.code)
            found.append(pytest.param(block, id=f"{block.document}-{block.number}", marks=marks))
    return found


@pytest.mark.parametrize("words", commands("adamanip"))
def test_adamanip_commands_parse(words: list[str]) -> None:
    parse_command(words[1], words[2:])


CHECKPOINTS = {
    "lerobot/smolvla_base": "smolvla",
    "outputs/first_act/checkpoints/last/pretrained_model": "act",
}
"""Checkpoints whose policies get options in the documents, and the kinds of these policies."""


def lerobot_config(words: list[str]) -> tuple[type, list[str]]:
    """The configuration class of a LeRobot command, and its arguments less those that need a checkpoint on disk."""
    from lerobot.configs.eval import EvalPipelineConfig
    from lerobot.configs.train import TrainPipelineConfig
    from lerobot.rollout.configs import RolloutConfig
    from lerobot.scripts import lerobot_record, lerobot_replay, lerobot_teleoperate

    kinds: dict[str, type] = {
        "lerobot-train": TrainPipelineConfig,
        "lerobot-eval": EvalPipelineConfig,
        "lerobot-record": lerobot_record.RecordConfig,
        "lerobot-replay": lerobot_replay.ReplayConfig,
        "lerobot-rollout": RolloutConfig,
        "lerobot-teleoperate": lerobot_teleoperate.TeleoperateConfig,
    }
    if words[0] == "accelerate":
        words = ["lerobot-train", *words[words.index("$(which lerobot-train)") + 1 :]]
    files = ("--policy.path=", "--config_path=")
    known = [f"--policy.type={kind}" for path, kind in CHECKPOINTS.items() if f"--policy.path={path}" in words]
    return kinds[words[0]], [*known, *(word for word in words[1:] if not word.startswith(files))]


ROBOTS = ("lerobot-record", "lerobot-replay", "lerobot-rollout", "lerobot-teleoperate")


@pytest.mark.parametrize("words", commands(ROBOTS))
def test_robot_commands_parse(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    import draccus

    import lerobot_env_adamanip  # noqa: F401  (as LeRobot does with every installed plugin)

    kind, arguments = lerobot_config(words)
    if words[0] == "lerobot-rollout":  # its policy is a checkpoint on disk
        monkeypatch.setattr(kind, "__post_init__", lambda _: None)
    robot = draccus.parse(config_class=kind, args=arguments).robot
    assert f"--robot.type={robot.type}" in words


@pytest.mark.parametrize("words", [*commands("lerobot-train"), *commands("lerobot-eval"), *commands("accelerate")])
def test_lerobot_commands_parse(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import draccus

    import lerobot_env_adamanip  # noqa: F401  (as LeRobot does with every installed plugin)

    write_asset_safe(tmp_path / "assets" / "safe" / "sa1")
    monkeypatch.chdir(tmp_path)  # the documents say `assets` for the reader's own folder
    kind, arguments = lerobot_config(words)
    if "--resume=true" in arguments:  # the rest is in the checkpoint's file
        arguments += ["--dataset.repo_id=local/x", "--policy.type=dp3_adaptive"]
    config = draccus.parse(config_class=kind, args=arguments)
    policy, env = config.policy, config.env
    for given in arguments:
        key, _, value = given.removeprefix("--").partition("=")
        if key == "policy.type":
            assert policy.type == value
        if key == "env.type":
            assert env.type == value
        if key == "policy.input_features":
            check_input_features(policy.input_features, env.image_size)


def test_job_scripts_are_bash() -> None:
    scripts = [block.code for block in blocks("bash") if block.code.startswith("#!/bin/bash")]
    assert len(scripts) == 2
    for script in scripts:
        done = subprocess.run(["bash", "-n"], input=script, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def check_input_features(features: dict[str, Any], image_size: int) -> None:
    """What the documents tell policies to look at exists, as large as their environment's, channels first."""
    table = schema.dataset_features(image_size=image_size)
    for key, feature in features.items():
        shape = tuple(table[key]["shape"])
        assert tuple(feature.shape) == ((shape[2], *shape[:2]) if key == schema.FRONT_IMAGE else shape)


@pytest.mark.parametrize("words", commands("lerobot-dataset-viz"))
def test_options_of_the_viewer_exist(words: list[str]) -> None:
    spec = importlib.util.find_spec("lerobot.scripts.lerobot_dataset_viz")
    source = Path(str(spec and spec.origin)).read_text(encoding="utf-8")
    assert all(f'"{word}"' in source for word in words[1:] if word.startswith("--"))


def test_make_targets_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    text = "\n".join((ROOT / document).read_text(encoding="utf-8") for document in DOCUMENTS)
    assert set(re.findall(r"\bmake ([a-z]+)\b(?=[`\n ]*(?:#|`|$|\())", text)) <= targets


def run_block(block: Block, folder: Path) -> None:
    if block.mark == "outputs/demos":
        collect_fake_demos(folder / "outputs" / "demos")
    if block.mark == "assets":
        write_asset_safe(folder / "assets" / "safe" / "sa1")
    done = subprocess.run([sys.executable, "-c", block.code], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{block.code}\n{done.stdout}\n{done.stderr}"


@pytest.mark.usefixtures("no_vulkan")
@pytest.mark.parametrize("block", python_blocks())
def test_python_runs(block: Block, tmp_path: Path) -> None:
    run_block(block, tmp_path)


def test_what_python_imports_of_ours_is_there() -> None:
    for block in (each.values[0] for each in python_blocks()):
        for node in ast.walk(ast.parse(block.code)):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("lerobot_"):
                module = importlib.import_module(str(node.module))
                for each in node.names:
                    assert hasattr(module, each.name) or importlib.import_module(f"{node.module}.{each.name}"), block


def anchors(path: Path) -> set[str]:
    """Anchors of a page: of its headings, as GitHub spells them, and of its elements with an id."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = [re.sub(r"\[(.*?)\]\(.*?\)", r"\1", title) for title in re.findall(r"^#+ (.*)$", text, re.MULTILINE)]
    named = re.findall(r'id="([^"]+)"', text)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in headings} | set(named)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_links_exist_and_no_path_of_a_machine_is_named(document: str) -> None:
    path = ROOT / document
    text = path.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if not target.startswith(("http://", "https://")):
            file, _, anchor = target.partition("#")
            there = path.parent / file if file else path
            assert there.exists(), target
            assert not anchor or there.suffix != ".md" or anchor in anchors(there), target
    assert not re.search(r"(?<![\w.])/(home|root|work|tmp|Users)/", text)


def test_images_are_small_and_shown() -> None:
    shown = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md"))
    for path in (ROOT / "docs" / "images").glob("*.[pw]*[!y]"):
        assert path.stat().st_size < (3_000_000 if path.suffix == ".webp" else 600_000), path.name
        assert f"images/{path.name})" in shown, path.name


def table(name: str, document: str) -> list[list[str]]:
    """Cells of the rows of a marked table in a document, without its header."""
    text = (ROOT / "docs" / document).read_text(encoding="utf-8")
    match = re.search(rf"<!-- {name} -->\n(.*?)<!-- /{name} -->", text, re.DOTALL)
    assert match is not None
    return [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in match[1].splitlines()[2:]]


def test_contract_table_is_the_schema() -> None:
    written = [(key, dtype, shape) for key, dtype, shape, _ in table("contract", "dataset_columns.md")]
    features = schema.dataset_features()
    assert written == [(key, feature["dtype"], str(tuple(feature["shape"]))) for key, feature in features.items()]
    meaning = {key: text for key, _, _, text in table("contract", "dataset_columns.md")}
    for key, labels in ((schema.PHASE, Phase), (schema.OUTCOME, Outcome)):
        for label in labels:
            name = "time limit" if label.name == "TIMEOUT" else label.name.lower()
            assert f"{label.value} {name}" in meaning[key]


@pytest.mark.sim  # the driver's module imports sapien
def test_motion_limits_are_the_codes() -> None:
    from lerobot_adamanip.contract.keyframes import MotionLimits

    written = {name: float(value) for name, value, _ in table("limits", "concepts.md")}
    actual = {key: value for key, value in dataclasses.asdict(MotionLimits()).items() if not key.startswith("reach_")}
    assert written == actual


def option_pages() -> str:
    from make_reference import pages

    return "\n".join(pages().values())


def test_pages_of_the_site_hold_every_command_and_explain_every_option() -> None:
    text = option_pages()
    assert set(re.findall(r"^## (\w+)$", text, re.MULTILINE)) == set(COMMANDS)
    options = re.findall(r"^\| `(--[\w.-]+)` \|.*\| ([^|]*) \|$", text, re.MULTILINE)
    assert len(options) > 50
    assert [name for name, meaning in options if not meaning] == []


def spans(document: str) -> list[str]:
    """Inline code of a document."""
    text = re.sub(r"^```.*?^```", "", (ROOT / document).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return re.findall(r"`([^`\n]+)`", text)


PRESENT = [document for document in DOCUMENTS if document != "CHANGELOG.md"]
OTHERS = {
    "--resume", "--steps", "--policy.path", "--policy.type", "--env.", "--env.categories", "--env.server",
    "--write", "--first-seed", "--result", "--evaluate",
}  # fmt: skip
"""Options that the documents name of LeRobot and of scripts."""


def test_options_in_the_text_exist() -> None:
    """Those of `adamanip`, of environments and of policies."""
    import lerobot.policies  # noqa: F401  (this and the next one register configurations)
    from lerobot.configs.policies import PreTrainedConfig

    import lerobot_env_adamanip  # noqa: F401

    known = OTHERS | set(re.findall(r"`(--[\w.-]+)`", option_pages()))
    for kind in ("dp3_adaptive", "vat_mart", "adaafford", "sampling", "act", "diffusion"):
        known |= {f"--policy.{field.name}" for field in dataclasses.fields(PreTrainedConfig.get_choice_class(kind))}
    gone = {
        (document, option)
        for document in PRESENT
        for span in spans(document)
        for option in re.findall(r"(?<![\w-])(--(?:env|policy)\.\w*|--[a-z-]+(?![\w.]))", span)
        if option not in known
    }
    assert gone == set()


@pytest.mark.sim  # imports modules of the simulator
def test_files_and_modules_in_the_text_exist() -> None:
    new = set(re.findall(r"<!-- new: ([\w./]+) -->", "".join((ROOT / page).read_text() for page in PRESENT)))
    gone = set()
    for document in PRESENT:
        for span in spans(document):
            if re.fullmatch(r"(?:lerobot_adamanip|envs|policies|scripts|tests|examples)/[\w./]*", span):
                if not (ROOT / span).exists() and span not in new:
                    gone.add((document, span))
            elif name := re.fullmatch(
                r"(lerobot_(?:adamanip|env_adamanip|policy_adamanip)(?:\.\w+)+)(?:\(.*\))?", span
            ):
                try:
                    resolve_name(name[1])
                except (ImportError, AttributeError):
                    gone.add((document, span))
    assert gone == set()
