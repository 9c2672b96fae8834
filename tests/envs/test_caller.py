"""What an environment's configuration finds out about LeRobot's command that holds it."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from doc_data import collect_fake_demos
from lerobot.configs.default import DatasetConfig
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.configs.types import FeatureType, PolicyFeature

from lerobot_env_adamanip.caller import images_wanted
from lerobot_env_adamanip.config import (
    AdaManipDoorEnvConfig,
    AdaManipLampEnvConfig,
    AdaManipSafeEnvConfig,
)
from lerobot_env_adamanip.suite import AdaManipSuiteEnvConfig

IMAGE = {"observation.images.front": PolicyFeature(FeatureType.VISUAL, (3, 64, 64))}
CLOUD = {"observation.point_cloud": PolicyFeature(FeatureType.ENV, (64, 3))}


def pipeline_of(kind: type, config: Any, **policy: Any) -> Any:
    options = {"dataset": DatasetConfig("local/x")} if kind is TrainPipelineConfig else {}
    made = kind(env=config, **options)
    made.policy = SimpleNamespace(**policy)
    return made


@pytest.mark.parametrize("kind", [EvalPipelineConfig, TrainPipelineConfig])
@pytest.mark.parametrize(("inputs", "wanted"), [(IMAGE, True), (CLOUD, False), ({}, True)])
def test_images_are_wanted_by_who_looks_at_them(kind: type, inputs: dict[str, PolicyFeature], wanted: bool) -> None:
    """Also in a training's evaluations, whose policy knows its inputs by then."""
    config = AdaManipSafeEnvConfig()
    pipeline = pipeline_of(kind, config, input_features=inputs)
    assert images_wanted(pipeline.env) is wanted
    assert config.options.observe_images is wanted


def told(caplog: pytest.LogCaptureFixture, config: Any, checkpoint: Path) -> list[tuple[int, str]]:
    caplog.clear()
    pipeline = pipeline_of(EvalPipelineConfig, config, input_features=CLOUD, pretrained_path=checkpoint)
    with caplog.at_level(logging.INFO, "lerobot_env_adamanip"):
        pipeline.env.create_envs(1)
    return [(each.levelno, each.message) for each in caplog.records if "was trained on" in each.message]


def checkpoint_of(folder: Path, **training: Any) -> Path:
    folder.mkdir()
    (folder / "train_config.json").write_text(json.dumps(training))
    return folder


def test_a_policy_of_another_category_is_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    root = tmp_path / "outputs" / "demos"
    collect_fake_demos(root)  # of safe_000 and safe_001
    path = checkpoint_of(tmp_path / "policy", dataset={"root": str(root), "repo_id": "local/x"}, env=None)
    ((level, said),) = told(caplog, AdaManipLampEnvConfig(), path)
    assert level == logging.WARNING
    assert "trained on safe, not on lamp" in said
    ((level, said),) = told(caplog, AdaManipSafeEnvConfig(objects="0:4"), path)
    assert level == logging.INFO
    assert "2 of the 4 objects" in said
    ((level, said),) = told(caplog, AdaManipSafeEnvConfig(objects="unseen"), path)
    assert "on 0 of the" in said
    levels = [level for level, _ in told(caplog, AdaManipSuiteEnvConfig(categories="safe,lamp,door"), path)]
    assert sorted(levels) == [logging.INFO, logging.WARNING, logging.WARNING]


def test_without_the_dataset_the_trainings_environment_tells(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    gone = {"root": str(tmp_path / "gone"), "repo_id": "local/x"}
    path = checkpoint_of(tmp_path / "policy", dataset=gone, env={"type": "adamanip_door"})
    assert [level for level, _ in told(caplog, AdaManipLampEnvConfig(), path)] == [logging.WARNING]
    assert told(caplog, AdaManipDoorEnvConfig(), path) == []
    suite = checkpoint_of(tmp_path / "suite", dataset=gone, env={"type": "adamanip"})
    assert told(caplog, AdaManipLampEnvConfig(), suite) == []


@pytest.mark.parametrize("content", ["", "[]", "{", '{"dataset": 3, "env": "x"}', '{"dataset": {"root": 3}}'])
def test_what_a_checkpoint_does_not_tell_harms_nothing(
    content: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "train_config.json").write_text(content)
    assert told(caplog, AdaManipLampEnvConfig(), tmp_path) == []
    assert told(caplog, AdaManipLampEnvConfig(), tmp_path / "none") == []


@pytest.mark.parametrize("main", [None, SimpleNamespace(), SimpleNamespace(__spec__=None)])
def test_the_plugin_loads_in_an_interpreter_without_a_main_module(
    main: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    import lerobot_env_adamanip as plugin

    if main is None:
        monkeypatch.delitem(sys.modules, "__main__")
    else:
        monkeypatch.setitem(sys.modules, "__main__", main)
    exec(Path(plugin.__file__).read_text(encoding="utf-8"), {"__name__": plugin.__name__})
