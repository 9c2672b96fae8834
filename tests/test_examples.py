"""Every example runs, and shows what it says it shows."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from doc_data import collect_fake_demos

from lerobot_adamanip.datasets.check.dataset import check

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
TESTED = {"watch_an_expert", "hidden_state", "load_dataset", "own_expert", "evaluate_a_policy", "record_a_policy"}


Run = Callable[..., str]


@pytest.fixture
def run(no_vulkan: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    """Runs an example as its command would be; in this process, without a Vulkan device."""

    def run(name: str, *arguments: str) -> str:
        path = ROOT / "examples" / f"{name}.py"
        monkeypatch.setattr(sys, "argv", [str(path), *arguments])
        monkeypatch.chdir(tmp_path)
        runpy.run_path(str(path), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_every_example_is_run_here_and_named_on_the_page() -> None:
    assert {path.stem for path in EXAMPLES} == TESTED
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    for path in EXAMPLES:
        assert f"examples/{path.name}" in page


def test_a_dataset_is_read(tmp_path: Path, run: Run) -> None:
    collect_fake_demos(tmp_path / "outputs" / "demos")
    said = run("load_dataset", "outputs/demos")
    assert "observation.point_cloud" in said
    assert "failed tries so far" in said


@pytest.mark.sim
def test_a_policy_is_recorded_as_a_dataset(tmp_path: Path, run: Run) -> None:
    said = run("record_a_policy", "outputs/mine", "--category", "lamp", "--episodes", "2")
    assert "dataset: " in said
    assert check(tmp_path / "outputs" / "mine").findings == []


@pytest.mark.sim
def test_an_expert_is_watched(tmp_path: Path, run: Run) -> None:
    said = run("watch_an_expert")
    assert "success" in said
    assert (tmp_path / "outputs" / "expert.mp4").stat().st_size > 1000


@pytest.mark.sim
def test_hidden_states_look_the_same_until_something_is_tried(run: Run) -> None:
    lines = run("hidden_state").splitlines()
    assert "they differ" in lines[-1]
    same = [line for line in lines if "the same to the bit" in line]
    assert len(same) >= 3
    assert any("TRY" in line for line in same)  # up to and including what is seen before the first try


@pytest.mark.sim
def test_an_expert_of_ones_own_opens_either_way(run: Run) -> None:
    lines = run("own_expert").splitlines()
    assert [line.split(":")[1].split()[0] for line in lines if line.startswith("locked")] == ["success", "success"]


@pytest.mark.sim
def test_a_policy_is_evaluated(tmp_path: Path, run: Run) -> None:
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.factory import make_pre_post_processors

    from lerobot_adamanip.contract import schema
    from lerobot_policy_adamanip import DP3AdaptiveConfig
    from lerobot_policy_adamanip.dp3_adaptive.modeling_dp3_adaptive import DP3AdaptivePolicy

    config = DP3AdaptiveConfig(
        num_points=64,
        encoder_dims=(16, 24),
        encoder_out_dim=16,
        device="cpu",
        input_features={
            schema.POINT_CLOUD: PolicyFeature(FeatureType.ENV, (64, 3)),
            schema.STATE: PolicyFeature(FeatureType.STATE, (schema.STATE_DIM,)),
        },
        output_features={schema.ACTION: PolicyFeature(FeatureType.ACTION, (schema.ACTION_DIM,))},
    )
    policy = DP3AdaptivePolicy(config)
    for part in (policy, *make_pre_post_processors(config)):
        part.save_pretrained(tmp_path / "checkpoint")
    said = run("evaluate_a_policy", "checkpoint", "--episodes", "1", "--key-frames", "2")
    assert "/1, 95 % interval" in said
