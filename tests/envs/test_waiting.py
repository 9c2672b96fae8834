"""Vector environments without a simulator: ended episodes wait, processes may die, policies may say NaN."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from counter_env import Counter, makers
from lerobot.envs.utils import NEW_ROLLOUT_OPTION

from lerobot_adamanip.episode.options import MALFORMED_ACTION
from lerobot_adamanip.util.errors import ConfigurationError, SimulatorError
from lerobot_env_adamanip import vector
from lerobot_env_adamanip.gym_interface import NEW_ROLLOUT
from lerobot_env_adamanip.vector import AsyncSimulators, SyncSimulators

ZEROS = np.zeros((2, 1), np.float32)


SERVER = forkserver.ForkServer()


@pytest.fixture(autouse=True)
def _light(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes that import no simulator."""
    monkeypatch.setattr(vector, "_server", SERVER)
    monkeypatch.setattr(vector, "PRELOADED", ["lerobot.envs.utils", "lerobot_env_adamanip.vector"])
    monkeypatch.setattr(vector, "CLOSE_TIMEOUT_S", 1.0)


@pytest.fixture
def processes() -> Iterator[AsyncSimulators]:
    made = AsyncSimulators(makers())
    yield made
    made.close()


@pytest.fixture(params=[SyncSimulators, AsyncSimulators])
def envs(request: pytest.FixtureRequest) -> Iterator[gym.vector.VectorEnv[Any, Any, Any]]:
    made = request.param(makers())
    yield made
    made.close()


def test_an_ended_episode_waits_until_a_reset_with_or_without_a_seed(envs: Any) -> None:
    for seed in ([0, 1], None, 3):
        observation, _ = envs.reset(seed=seed)
        assert observation.tolist() == [[0.0], [0.0]]
        steps = [envs.step(ZEROS) for _ in range(4)]
        assert [step[0][0, 0] for step in steps] == [1, 2, 2, 2]
        assert [step[1][0] for step in steps] == [1, 1, 0, 0]
    assert envs.get_attr("episodes") == (3, 3)


def test_both_are_gymnasiums_and_alike(envs: Any) -> None:
    assert isinstance(envs, gym.vector.VectorEnv)
    assert envs.observation_space == gym.spaces.Box(0, 100, (2, 1), np.float32)
    assert envs.action_space == gym.spaces.Box(-1, 1, (2, 1), np.float32)
    assert envs.single_action_space == Counter.action_space
    assert envs.metadata == {**Counter.metadata, "autoreset_mode": gym.vector.AutoresetMode.NEXT_STEP}
    assert envs.render_mode == "rgb_array"
    wrapped = gym.wrappers.vector.RecordEpisodeStatistics(envs)
    wrapped.reset(seed=[0, 1])
    envs.set_attr("steps", [0, 1])
    assert wrapped.step(ZEROS)[0].tolist() == [[1.0], [2.0]]
    assert np.shape(envs.render()) == (2, 4, 4, 3)
    assert NEW_ROLLOUT == NEW_ROLLOUT_OPTION


def test_an_action_with_nan_fails_its_episode_and_no_other(envs: Any) -> None:
    envs.reset(seed=[0, 1])
    _, rewards, _, truncated, info = envs.step(np.array([[np.nan], [0.0]], np.float32))
    assert (rewards.tolist(), truncated.tolist(), info["limit"].tolist()) == (
        [0, 1],
        [True, False],
        [MALFORMED_ACTION, ""],
    )
    assert envs.step(ZEROS)[2].tolist() == [False, True]


def kill(envs: AsyncSimulators) -> None:
    os.kill(envs.call("pid")[1], signal.SIGKILL)
    time.sleep(0.1)


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    "use",
    [
        lambda envs: envs.step(ZEROS),
        lambda envs: envs.reset(),
        lambda envs: envs.call("pid"),
        lambda envs: envs.set_attr("limit", ""),
        lambda envs: envs.render(),
    ],
)
def test_a_process_killed_between_calls_is_one_error_and_none_is_left(processes: AsyncSimulators, use: Any) -> None:
    processes.reset(seed=0)
    kill(processes)
    left = list(processes.processes)
    with pytest.raises(SimulatorError, match=r"(?s)process has ended.*environment 1: killed by SIGKILL.*batch_size"):
        use(processes)
    assert not any(process.is_alive() for process in left)
    assert processes.reset(seed=0)[0].tolist() == [[0.0], [0.0]]  # new ones


@pytest.mark.timeout(60)
def test_a_process_killed_in_a_call_is_one_error(processes: AsyncSimulators) -> None:
    processes.reset(seed=0)
    with pytest.raises(SimulatorError, match="killed by SIGKILL"):
        processes.call("die")
    processes.close()


@pytest.mark.timeout(60)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_closing_ends_whatever_state_the_processes_are_in(
    processes: AsyncSimulators, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    processes.reset(seed=0)
    left = list(processes.processes)
    os.kill(left[0].pid, number)
    began = time.monotonic()
    processes.close()
    processes.close()
    assert time.monotonic() - began < 10.0
    assert not any(process.is_alive() for process in left)


@pytest.mark.timeout(60)
def test_a_process_that_hangs_is_one_error(processes: AsyncSimulators, monkeypatch: pytest.MonkeyPatch) -> None:
    processes.reset(seed=0)
    monkeypatch.setattr(vector, "WORKER_TIMEOUT_S", 1.0)
    os.kill(processes.call("pid")[0], signal.SIGSTOP)
    with pytest.raises(SimulatorError, match="does not answer"):
        processes.step(ZEROS)


@pytest.mark.timeout(60)
def test_an_error_of_an_environment_is_raised_and_leaves_no_process(processes: AsyncSimulators) -> None:
    processes.reset(seed=0)
    with pytest.raises(AttributeError):
        processes.call("no_such_method")
    assert processes.processes == []
    with pytest.raises(ConfigurationError, match=r"(?s)Impossible direction.*allowed: -1 or 1"):
        processes.call("refuse")
    assert processes.reset(seed=0)[0].tolist() == [[0.0], [0.0]]


@pytest.mark.timeout(60)
def test_python_ends_in_silence_after_a_close(tmp_path: Path) -> None:
    lines = [
        "from counter_env import makers",
        "from lerobot_env_adamanip import vector",
        "if __name__ == '__main__':",
        "    vector.PRELOADED, envs = [], vector.AsyncSimulators(makers())",
        "    envs.reset(seed=0)",
        "    envs.close()",
    ]
    path = tmp_path / "script.py"
    path.write_text("\n".join(lines))
    folders = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, str(path)], env={**os.environ, **folders}, capture_output=True, text=True, check=True
    )
    assert "Exception ignored" not in done.stderr, done.stderr


def test_environments_that_are_used_again_are_closed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    envs, closed = SyncSimulators(makers()), []
    monkeypatch.setattr(Counter, "close", lambda self: closed.append(0))
    for _ in range(2):
        envs.reset(seed=0)
        envs.close()
    assert len(closed) == 4


@pytest.mark.timeout(60)
def test_other_processes_of_the_caller_inherit_nothing(
    processes: AsyncSimulators, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    connect = forkserver.connect_to_new_process
    monkeypatch.setattr(vector, "_server", forkserver.ForkServer())
    processes.reset(seed=0)
    assert processes.call("limits") == (("1", True),) * 2
    assert os.environ["OMP_NUM_THREADS"] == "3"
    assert forkserver.connect_to_new_process == connect
    assert forkserver._forkserver._forkserver_pid == usual  # type: ignore[attr-defined]
