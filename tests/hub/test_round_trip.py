"""There and back: trained and evaluated on what the Hub gave, all is as on what was sent; LeRobot's own push too."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from huggingface_hub import HfApi, ModelCard
from lerobot.policies.pretrained import PreTrainedPolicy
from loopback_hub import LoopbackHub
from safetensors import safe_open
from tiny_training import TINY

from lerobot_adamanip.datasets.cards import check_card
from lerobot_adamanip.evaluation.log import read_log
from lerobot_adamanip.hub.push import push
from lerobot_adamanip.hub.scan import Names, scan
from lerobot_adamanip.hub.staging import Staged, stage_model

pytestmark = pytest.mark.timeout(900)  # trainings in processes of their own

NAME, POLICY = "someone/safes", "someone/policy"


def weights(path: Path) -> dict[str, bytes]:
    with safe_open(path, framework="np") as tensors:
        return {name: tensors.get_tensor(name).tobytes() for name in tensors.keys()}  # noqa: SIM118  (no mapping)


@pytest.fixture
def on_the_hub(staged: Staged, api: HfApi, hub: LoopbackHub) -> LoopbackHub:
    """A Hub that has the dataset."""
    push(staged, api)
    return hub


def test_training_on_the_pulled_dataset_gives_the_same_policy_and_lerobots_push_publishes_it(
    on_the_hub: LoopbackHub, trained: Path, run: Any, tmp_path: Path
) -> None:
    hub, output = on_the_hub, tmp_path / "run"
    train = ("-m", "lerobot.scripts.lerobot_train", *TINY, f"--dataset.repo_id={NAME}", f"--output_dir={output}")
    publish = ("--policy.push_to_hub=true", f"--policy.repo_id={POLICY}")
    has_hook = hasattr(PreTrainedPolicy, "generate_model_card")
    done = run(*train, *publish, check=has_hook)
    if not has_hook:  # later than LeRobot 0.6.1
        assert "adamanip push model" in done.stderr
        assert ("models", POLICY) not in hub.repositories
        run(*train, "--policy.push_to_hub=false")
    checkpoint = output / "checkpoints" / "000003" / "pretrained_model"
    assert weights(checkpoint / "model.safetensors") == weights(trained / "model.safetensors")
    if not has_hook:
        return
    remote = hub.files("models", POLICY)
    pulled = tmp_path / "remote"
    for name, content in remote.items():
        (pulled / name).parent.mkdir(parents=True, exist_ok=True)
        (pulled / name).write_bytes(content)
    for name in (path.name for path in checkpoint.glob("policy_*")):
        assert remote[name] == (checkpoint / name).read_bytes()
    assert weights(pulled / "model.safetensors") == weights(checkpoint / "model.safetensors")
    card = remote["README.md"].decode()
    check_card(card, "model")
    assert ModelCard(card).data.datasets == [NAME]
    assert str(output) in (checkpoint / "train_config.json").read_text()  # what LeRobot would have published
    assert scan({name: pulled / name for name in remote}, Names.here(tmp_path, output), owner="someone") == []
    assert json.loads(remote["train_config.json"])["output_dir"] is None


@pytest.mark.nightly
@pytest.mark.sim
def test_the_pulled_policy_acts_as_the_local_one(
    api: HfApi, hub: LoopbackHub, trained: Path, run: Any, tmp_path: Path
) -> None:
    (tmp_path / "staged").mkdir()
    push(stage_model(trained, POLICY, tmp_path / "staged"), api)
    logs = []
    for name, path in (("local", str(trained)), ("pulled", POLICY)):
        log = tmp_path / f"{name}.jsonl"
        evaluation = (
            f"--policy.path={path}", "--policy.device=cpu", "--env.type=adamanip_safe", "--env.num_points=8",
            "--env.episode_length=4", f"--env.episode_log={log}", "--eval.n_episodes=1", "--eval.batch_size=1",
            "--seed=3", f"--output_dir={tmp_path / name}",
        )  # fmt: skip
        run("-m", "lerobot.scripts.lerobot_eval", *evaluation)
        logs.append([{**each.to_json(), "run_id": None} for each in read_log(log)])
    assert logs[0] == logs[1]
    assert hub.count(r"GET /someone/policy/resolve/.*/policy_preprocessor.json") == 1
