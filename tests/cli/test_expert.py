"""`adamanip expert`: the scenes and the log of `lerobot-eval`, with an expert instead of a policy."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from envs_helpers import SMALL

from lerobot_adamanip import experts
from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract.keyframes import KeyFrames
from lerobot_adamanip.evaluation.metrics import within_best_tries
from lerobot_adamanip.evaluation.record import read_log
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

SCENES, FIRST = 4, 700_000


@pytest.mark.sim
@pytest.mark.parametrize("expert", ["adaptive", "static"])
def test_an_expert_opens_all_within_the_best_tries(
    expert: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "episodes.jsonl"
    command = f"expert --category lamp --expert {expert} --split test --seed {FIRST} --episodes {SCENES}"
    assert main([*command.split(), "--max-failed-tries=best", "--episode-log", str(log), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["episode_log"] == str(log)
    records = read_log(log)
    assert [record.given_seed for record in records] == list(range(FIRST, FIRST + SCENES))
    assert {record.split for record in records} == {"test"}
    assert all(map(within_best_tries, records))
    if expert == "static":
        assert not any(record.failed_tries for record in records)
    env = KeyframeEnv("lamp", **{**SMALL, "objects": "seen", "observe_images": False, "split": "test"})
    for record in records[:2]:
        env.reset(seed=record.given_seed)
        assert (env.hidden_state(), env.episode_record()["object_id"]) == (record.hidden_state, record.object_id)
    env.close()


@pytest.mark.sim
def test_an_expert_that_gives_up_is_a_failed_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is in the log with all its key frames."""
    make = experts.make_expert

    def gives_up(*given: Any, **named: Any) -> KeyFrames:
        yield next(make(*given, **named))

    monkeypatch.setattr(experts, "make_expert", gives_up)
    log = tmp_path / "episodes.jsonl"
    command = f"expert --category lamp --objects 0:1 --episodes 1 --episode-length 6 --episode-log {log}"
    assert main(command.split()) == 0
    (record,) = read_log(log)
    assert (record.success, record.key_frames) == (False, 6)
