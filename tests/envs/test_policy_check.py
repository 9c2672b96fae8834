"""`lerobot-eval` stops a policy that was trained on other observations or on other categories."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.factory import make_env_config
from lerobot.policies.act.configuration_act import ACTConfig
from sound_demos import collect_sound

import lerobot_env_adamanip  # noqa: F401  (registers the policies)
from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip import policy_check
from lerobot_env_adamanip.config import AdaManipSafeEnvConfig
from lerobot_env_adamanip.policy_check import require_fitting_policy, trained_categories

CHECKPOINT = Path(__file__).parents[1] / "policies" / "demo_checkpoint"
LOWER, UPPER = (0.2, -0.5, -0.05), (0.9, 0.5, 0.6)


def checkpoint(folder: Path, *, pixels: int | None = None, state: int = schema.STATE_DIM, **training: Any) -> Path:
    """An ACT policy's configuration, and that of its training."""
    inputs = {schema.STATE: PolicyFeature(FeatureType.STATE, (state,))}
    if pixels is not None:
        inputs[schema.FRONT_IMAGE] = PolicyFeature(FeatureType.VISUAL, (3, pixels, pixels))
    folder.mkdir()
    ACTConfig(input_features=inputs, push_to_hub=False)._save_pretrained(folder)
    (folder / "train_config.json").write_text(json.dumps(training))
    return folder


def evaluate(
    monkeypatch: pytest.MonkeyPatch, path: Path, env_type: str = "adamanip_safe", *more: str, **options: Any
) -> None:
    """As `lerobot-eval` makes its environments."""
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", f"--policy.path={path}", *more])
    config = make_env_config(env_type, **{"observe_images": False, **options})
    if not config.observe_images:
        config.features.pop(schema.FRONT_IMAGE, None)
    categories = config.chosen() if env_type == "adamanip" else [config.category]
    require_fitting_policy(config, categories)


DATA = {"dataset": {"root": None, "repo_id": "nobody/nothing"}}


def test_another_picture_size_is_one_error_with_both(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = checkpoint(tmp_path / "act", pixels=96)
    with pytest.raises(ConfigurationError, match=r"(?s)got: .*\(3, 256, 256\).*allowed: \(3, 96, 96\).*image_size=96"):
        evaluate(monkeypatch, path, observe_images=True)
    evaluate(monkeypatch, path, observe_images=True, image_size=96)
    with pytest.raises(ConfigurationError, match=r"(?s)observe none.*--env.observe_images=true --env.image_size=96"):
        evaluate(monkeypatch, path)


def test_another_state_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)\(24,\).*\(44,\).*adamanip keyframes"):
        evaluate(monkeypatch, checkpoint(tmp_path / "dense", state=44))


def test_another_category_is_one_error_with_both(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = collect_sound(tmp_path / "demos", observe_images=False)
    path = checkpoint(tmp_path / "act", dataset={"root": str(root), "repo_id": "x/y"}, env={"type": "adamanip_door"})
    assert trained_categories(path) == ("safe",)  # the dataset decides
    evaluate(monkeypatch, path)
    for env_type, options in (("adamanip_door", {}), ("adamanip", {"categories": "safe,door"})):
        with pytest.raises(
            ConfigurationError, match=r"(?s)got: +environments of door\n.*allowed: +safe.*adamanip_safe"
        ):
            evaluate(monkeypatch, path, env_type, **options)
    evaluate(monkeypatch, path, "adamanip_door", "--dataset.repo_id=local/doors")  # a training that goes on from it
    evaluate(monkeypatch, path, "adamanip_door", other_categories=True)


@pytest.mark.parametrize(
    ("training", "known"),
    [
        ({**DATA, "env": {"type": "adamanip_pen"}}, ("pen",)),
        ({**DATA, "env": {"type": "adamanip", "categories": "lamp, pen"}}, ("pen", "lamp")),
        ({**DATA, "env": {"type": "pusht"}}, ()),
        ({**DATA, "env": None}, ()),
        ({}, ()),
    ],
)
def test_without_the_dataset_the_training_environment_counts(
    training: dict[str, Any], known: tuple[str, ...], tmp_path: Path
) -> None:
    assert trained_categories(checkpoint(tmp_path / "act", **training)) == known
    assert trained_categories(tmp_path / "nothing") == ()


def test_a_program_without_a_policy_is_not_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["my_program.py"])
    monkeypatch.setattr(policy_check, "_require_shapes", lambda *_: pytest.fail("no policy"))
    require_fitting_policy(make_env_config("adamanip_safe"), ["safe"])


def test_a_policy_of_another_workspace_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = json.loads((CHECKPOINT / "config.json").read_text())
    box = {"workspace_lower": list(LOWER), "workspace_upper": list(UPPER)}
    (tmp_path / "config.json").write_text(json.dumps({**settings, **box}))
    default, same = AdaManipSafeEnvConfig(), AdaManipSafeEnvConfig(workspace_lower=LOWER, workspace_upper=UPPER)
    require_fitting_policy(same, ["safe"])  # no policy is given
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", f"--policy.path={tmp_path}"])
    require_fitting_policy(same, ["safe"])
    pattern = (
        r"(?s)another workspace.*allowed: \(0\.2, -0\.5, -0\.05\).*--env\.workspace_lower='\[0\.2, -0\.5, -0\.05\]'"
    )
    with pytest.raises(ConfigurationError, match=pattern):
        default.create_envs(1)
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", f"--policy.path={CHECKPOINT}"])
    require_fitting_policy(default, ["safe"])


def test_a_memory_over_episodes_needs_scenes_that_are_played_again(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = "--policy.memory_episodes=3"
    with pytest.raises(ConfigurationError, match=r"(?s)different scenes.*repeats=1.*--env\.repeats=3"):
        evaluate(monkeypatch, CHECKPOINT, "adamanip_safe", kept)
    monkeypatch.setattr(sys, "argv", ["lerobot-train", "--policy.type=dp3_adaptive", kept])  # its own evaluation
    with pytest.raises(ConfigurationError, match="different scenes"):
        require_fitting_policy(make_env_config("adamanip_safe"), ["safe"])
    for repeats in (3, 6):
        evaluate(monkeypatch, CHECKPOINT, "adamanip_safe", kept, repeats=repeats)
    evaluate(monkeypatch, CHECKPOINT, repeats=2)  # no memory is kept


def test_a_memory_in_the_instruction_must_be_that_of_the_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = checkpoint(tmp_path / "act", env={"type": "adamanip_safe", "memory": "text"})
    with pytest.raises(ConfigurationError, match=r"(?s)memory=none.*try:.*--env.memory=text"):
        evaluate(monkeypatch, path)
    evaluate(monkeypatch, path, memory="text")


# Control --------------------------------------------------------------------------------------------------------------


def dense_checkpoint(folder: Path, *, action: int = 7, state: int = 8, fps: int = 10, **training: Any) -> Path:
    """An ACT policy's configuration, trained on data at control rate that are on this machine."""
    path = checkpoint(folder, state=state, **training)
    outputs = {schema.ACTION: PolicyFeature(FeatureType.ACTION, (action,))}
    inputs = {schema.STATE: PolicyFeature(FeatureType.STATE, (state,))}
    ACTConfig(input_features=inputs, output_features=outputs, push_to_hub=False)._save_pretrained(path)
    root = folder.parent / f"{folder.name}_data"
    (root / "meta").mkdir(parents=True)
    (root / "meta" / "info.json").write_text(json.dumps({"fps": fps, "features": {schema.KEY_FRAME: {}}}))
    options = {"dataset": {"root": str(root), "repo_id": "x/y"}, "env": {"type": "adamanip_safe"}, **training}
    (path / "train_config.json").write_text(json.dumps(options))
    return path


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        ({}, "--env.control=dense --env.fps=10 --env.action=ee_delta --env.state=pose"),
        ({"control": "dense", "fps": 25}, "--env.fps=10"),
        ({"control": "dense", "action": "joint"}, "--env.action=ee_delta"),
        ({"control": "dense", "state": "full"}, "--env.state=pose"),
    ],
    ids=str,
)
def test_another_control_is_one_error_with_the_options(
    options: dict[str, Any], hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Any
) -> None:
    path = dense_checkpoint(tmp_path / "act")
    message = refuses(ConfigurationError, lambda: evaluate(monkeypatch, path, **options))
    assert "another control" in message
    assert hint in message
    evaluate(monkeypatch, path, control="dense")


def test_a_policy_of_key_frames_is_not_for_control_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Any
) -> None:
    root = collect_sound(tmp_path / "demos", observe_images=False)
    path = checkpoint(tmp_path / "act", dataset={"root": str(root), "repo_id": "x/y"})
    wrong = {"control": "dense", "action": "ee_pose", "state": "full"}
    assert "--env.control=keyframe" in refuses(ConfigurationError, lambda: evaluate(monkeypatch, path, **wrong))
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", f"--policy.path={CHECKPOINT}"])
    config = make_env_config("adamanip_safe", observe_images=False, observe_cloud=True, **wrong)
    assert "--env.control=keyframe" in refuses(ConfigurationError, lambda: require_fitting_policy(config, ["safe"]))


def test_a_cloud_that_a_policy_needs_is_named_by_its_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Any
) -> None:
    path = dense_checkpoint(tmp_path / "act")
    inputs = {
        schema.STATE: PolicyFeature(FeatureType.STATE, (8,)),
        schema.POINT_CLOUD: PolicyFeature(FeatureType.ENV, (1024, 3)),
    }
    ACTConfig(input_features=inputs, push_to_hub=False)._save_pretrained(path)
    message = refuses(ConfigurationError, lambda: evaluate(monkeypatch, path, control="dense"))
    assert "--env.observe_cloud=true" in message


def test_without_the_dataset_the_sizes_of_action_and_state_tell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuses: Any
) -> None:
    path = dense_checkpoint(tmp_path / "act", action=8, state=24, **DATA)
    message = refuses(ConfigurationError, lambda: evaluate(monkeypatch, path))
    assert "--env.control=dense --env.action=joint --env.state=full" in message
    evaluate(monkeypatch, path, control="dense", action="joint", state="full", fps=25)


def test_a_policy_that_pads_states_and_resizes_pictures_keeps_the_shapes_of_its_first_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig

    cameras = {f"observation.images.camera{number}": (3, 256, 256) for number in (1, 2, 3)}
    inputs = {name: PolicyFeature(FeatureType.VISUAL, shape) for name, shape in cameras.items()}
    inputs[schema.STATE] = PolicyFeature(FeatureType.STATE, (6,))
    path = tmp_path / "smolvla"
    path.mkdir()
    SmolVLAConfig(input_features=inputs, push_to_hub=False, device="cpu")._save_pretrained(path)
    (path / "train_config.json").write_text(
        json.dumps({"env": {"type": "adamanip_safe", "control": "dense", "fps": 10}})
    )
    dense = {"control": "dense", "observe_images": True, "image_size": 96}
    names = {"camera_names": ("camera1", "camera2")}
    evaluate(monkeypatch, path, **dense, **names)
    with pytest.raises(ConfigurationError, match="other cameras"):
        evaluate(monkeypatch, path, **dense)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("", "--control dense --state pose"),
        ("--control dense --memory text", "--memory none"),
        ("--control dense --category lamp", "--category safe"),
    ],
)
def test_corrections_are_of_a_policy_that_fits(
    options: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = checkpoint(tmp_path / "act", state=8, **DATA, env={"type": "adamanip_safe", "memory": "none"})
    (path / "model.safetensors").touch()
    words = ["collect", str(tmp_path / "new"), "--category", "safe", "--no-images", "--policy", str(path)]
    assert main([*words, *options.split()]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
