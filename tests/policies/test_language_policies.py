"""What a page says of language policies: its commands run as typed, with tiny stand-ins for what they download."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from lerobot.datasets import LeRobotDataset
from lerobot.processor import PolicyProcessorPipeline
from lerobot.utils.constants import OBS_LANGUAGE_TOKENS
from page_commands import FEW, SHORT, TRAINING, documented, run

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.memory import SO_FAR

pytestmark = [pytest.mark.sim, pytest.mark.nightly, pytest.mark.transformers, pytest.mark.usefixtures("no_vulkan")]
DATA = "outputs/text_memory"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the page's demonstrations are, whose tasks tell what was tried."""
    folder = tmp_path_factory.mktemp("page")
    run(documented("adamanip", DATA), folder, *FEW)
    return folder


def stand_in(policy: str, folder: Path) -> list[str]:
    """Writes what a policy downloads into a folder; returns the options that name it, and make the policy tiny."""
    import tiny_downloads

    if policy == "smolvla":
        tiny_downloads.write_smolvla(folder)
        return [f"--policy.path={folder}"]
    tiny_downloads.write_clip(folder)
    names = [f"--policy.{encoder}_encoder_name={folder}" for encoder in ("vision", "text")]
    sizes = [
        "--policy.hidden_dim=32",
        "--policy.num_layers=1",
        "--policy.num_heads=2",
        "--policy.num_inference_steps=2",
    ]
    return [*names, *sizes, "--policy.image_resize_shape=[32,32]"]


@pytest.mark.parametrize("policy", ["smolvla", "multi_task_dit"])
def test_a_language_policy_is_trained_and_evaluated_with_a_memory_in_its_instruction(policy: str, folder: Path) -> None:
    training = [option for option in TRAINING if not option.startswith(("--env", "--eval"))]
    options = stand_in(policy, folder / f"{policy}_clip")
    run(documented("lerobot-train", f"outputs/text_memory_{policy}"), folder, *options, *training)
    checkpoint = folder / "outputs" / f"text_memory_{policy}" / "checkpoints" / "last" / "pretrained_model"
    run(documented("lerobot-eval", f"outputs/text_memory_{policy}"), folder, *SHORT)
    (line,) = (folder / "outputs" / f"text_memory_{policy}.jsonl").read_text().splitlines()
    assert json.loads(line)["category"] == "bottle"

    action = json.loads((checkpoint / "config.json").read_text())["output_features"][schema.ACTION]
    dataset = LeRobotDataset("local/text_memory", root=folder / DATA)
    assert action["shape"] == list(dataset.features[schema.ACTION]["shape"])
    processor = PolicyProcessorPipeline.from_pretrained(checkpoint, "policy_preprocessor.json")
    row = next(row for row in map(dataset.__getitem__, range(len(dataset))) if SO_FAR in row["task"])
    tokens = processor(row)[OBS_LANGUAGE_TOKENS][0]
    (step,) = (step for step in processor.steps if hasattr(step, "input_tokenizer"))
    assert step.input_tokenizer.decode(tokens, skip_special_tokens=True).rstrip("\n") == row["task"]
