"""Vector environments for LeRobot's rollouts: an ended environment waits for the next reset, processes start lazily.

They are `gymnasium.vector.VectorEnv`s. Those of ``gymnasium.make_vec`` reset an ended environment themselves.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import multiprocessing
import signal
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing import forkserver
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector.async_vector_env import AsyncState
from gymnasium.vector.utils import batch_space

from lerobot_adamanip.episode.options import MALFORMED_ACTION, EnvironmentOptions
from lerobot_adamanip.util.errors import ConfigurationError, SimulatorError
from lerobot_adamanip.util.jobs import thread_limits
from lerobot_env_adamanip.gym_interface import NEW_ROLLOUT
from lerobot_env_adamanip.make_environment import make_environment

_log = logging.getLogger(__name__)

Make = Callable[[], gym.Env[Any, Any]]
Transition = tuple[Any, float, bool, bool, dict[str, Any]]
AUTORESET = gym.vector.AutoresetMode.NEXT_STEP
WORKER_TIMEOUT_S = 600.0
"""Time limit of an answer [s]: a reset takes seconds, the first one a minute."""
CLOSE_TIMEOUT_S = 10.0
"""Time that processes have to end by themselves [s]; then they are killed."""
PRELOADED = ["lerobot_env_adamanip.fork_server_preload"]
_OUT_OF_MEMORY = "a smaller --eval.batch_size, if memory ran out (about 1 GB per environment)"
_AT_START = "`if __name__ == '__main__':` around your script; --eval.use_async_envs=false shows other causes"


class FlatCloud(gym.ObservationWrapper[Any, Any, Any]):
    """Flattens the point cloud to (3 N,), as in datasets: LeRobot's policies normalise it by dataset statistics."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        space = env.observation_space
        assert isinstance(space, gym.spaces.Dict)
        self.observation_space = gym.spaces.Dict(
            {**space, "point_cloud": gym.spaces.flatten_space(space["point_cloud"])}
        )

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Flattens (N, 3) to (3 N,)."""
        return {**observation, "point_cloud": observation["point_cloud"].reshape(-1)}


class CameraNames(gym.ObservationWrapper[Any, Any, Any]):
    """Renames the cameras of the images by ``names``: camera -> its name in observations."""

    def __init__(self, env: gym.Env[Any, Any], names: Mapping[str, str]) -> None:
        super().__init__(env)
        self._names, space = names, env.observation_space
        assert isinstance(space, gym.spaces.Dict)
        pixels: Any = space["pixels"]
        self.observation_space = gym.spaces.Dict({**space, "pixels": gym.spaces.Dict(self._renamed(pixels))})

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Renames the keys of ``pixels``."""
        return {**observation, "pixels": self._renamed(observation["pixels"])}

    def _renamed(self, cameras: Mapping[str, Any]) -> dict[str, Any]:
        return {self._names[camera]: value for camera, value in cameras.items()}


class FailMalformedActions(gym.Wrapper[Any, Any, Any, Any]):
    """Ends an episode without success at an action with NaN or infinity, so that the other episodes continue.

    A single `KeyframeEnv` raises `ConfigurationError` instead. An action of another shape is an error in both.
    """

    def step(self, action: Any) -> Transition:
        """Steps the environment; a non-finite action is not executed and ends the episode."""
        if np.isfinite(action).all():
            return self.env.step(action)  # type: ignore[return-value]  # Gymnasium types rewards as SupportsFloat
        env: Any = self.env.unwrapped
        _log.warning("A policy's action has NaN or infinity: its episode ends as failed (%s).", MALFORMED_ACTION)
        ended: Transition = env.end_episode(MALFORMED_ACTION)
        return ended


class SyncSimulators(gym.vector.SyncVectorEnv):
    """Environments of this process. `reset` starts new episodes in all of them, also after an ended one."""

    def __init__(self, makers: Sequence[Make]) -> None:
        super().__init__(makers, autoreset_mode=AUTORESET)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets like `gymnasium.vector.VectorEnv.reset`, whether or not seeds are given."""
        return super().reset(seed=seed, options=_new_rollout(options))

    def close(self, **kwargs: Any) -> None:
        """Ends the simulators; the next reset starts new ones."""
        self.close_extras(**kwargs)


class AsyncSimulators(gym.vector.AsyncVectorEnv):
    """Gymnasium's processes, started at first use and ended by `close` in any state; can be used again afterwards.

    A suite therefore runs the processes of one category at a time. New processes continue to number the evaluations of
    a log. If a process dies, hangs or raises an error, all are ended. LeRobot's lazy environments neither
    limit the time of an answer nor can they be closed after a death.

    Args:
        makers: one function per environment, picklable by cloudpickle.
    """

    def __init__(self, makers: Sequence[Make]) -> None:
        start_server()  # while the caller loads a policy
        self._makers, self._state = list(makers), AsyncState.DEFAULT
        self.parent_pipes, self.processes = [], []
        first = self._makers[0]()  # does not start the simulator
        self.num_envs, self.render_mode = len(self._makers), first.render_mode
        self.metadata = {**first.metadata, "autoreset_mode": AUTORESET}
        self.single_observation_space, self.single_action_space = first.observation_space, first.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        first.close()

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets like `gymnasium.vector.VectorEnv.reset`; raises `SimulatorError` if a process dies or hangs."""
        with self._running():
            self.reset_async(seed=seed, options=_new_rollout(options))
            return self.reset_wait(timeout=WORKER_TIMEOUT_S)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Steps like `gymnasium.vector.VectorEnv.step`; raises `SimulatorError` if a process dies or hangs."""
        with self._running():
            self.step_async(actions)
            return self.step_wait(timeout=WORKER_TIMEOUT_S)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Calls a method, or reads an attribute, of each environment; raises `SimulatorError` like `step`."""
        with self._running():
            self.call_async(name, *args, **kwargs)
            return self.call_wait(timeout=WORKER_TIMEOUT_S)

    def set_attr(self, name: str, values: Any) -> None:
        """Sets an attribute of each environment, from a list or tuple with one value each, or from one value."""
        with self._running():
            super().set_attr(name, values)

    def close(self, **kwargs: Any) -> None:
        """Ends the processes within `CLOSE_TIMEOUT_S`, also after an error; the next call starts new ones."""
        if self.processes or self.parent_pipes:  # Gymnasium closes again when Python ends, without its modules
            self._stop(at_once=False)

    def _stop(self, *, at_once: bool) -> None:
        """Ends the processes, whatever state they are in. With ``at_once`` they are killed."""
        for pipe in () if at_once else self.parent_pipes:
            with contextlib.suppress(OSError, AttributeError):  # its process has ended
                pipe.send(("close", None))
        deadline = time.monotonic() + CLOSE_TIMEOUT_S
        self.processes = [process for process in self.processes if process.pid is not None]
        for process in self.processes:
            if not at_once:
                process.join(max(0.0, deadline - time.monotonic()))
            if process.is_alive():
                process.kill()
        self._state = AsyncState.DEFAULT  # otherwise Gymnasium waits for pending results
        self.close_extras(terminate=True)
        self.parent_pipes, self.processes = [], []

    def _endings(self) -> list[str]:
        """Returns how processes have ended that should run."""
        deadline = time.monotonic() + 1.0  # a pipe closes a moment before its process can be reaped
        while all(process.exitcode is None for process in self.processes) and time.monotonic() < deadline:
            time.sleep(0.01)
        codes = [(number, process.exitcode) for number, process in enumerate(self.processes)]
        return [f"environment {number}: {_ending(code)}" for number, code in codes if code is not None]

    @contextlib.contextmanager
    def _running(self) -> Iterator[None]:
        """Starts the processes if there are none; after any error there are none, and the error names a dead one."""
        try:
            if not self.processes:
                with _server_in_use():
                    super().__init__(self._makers, context="forkserver", autoreset_mode=AUTORESET)
            yield
        except (EOFError, ConnectionError) as error:
            # Collecting frames that hold a half-sent message crashes Python 3.12.1.
            traceback.clear_frames(error.__traceback__)
            endings = "; ".join(self._endings())
            self._stop(at_once=True)
            raise SimulatorError(
                "A simulator's process has ended.",
                got=endings or "its connection is closed",
                allowed=f"{self.num_envs} running processes",
                hint=_OUT_OF_MEMORY if "SIGKILL" in endings else _AT_START,
            ) from error
        except multiprocessing.TimeoutError as error:
            self._stop(at_once=True)
            raise SimulatorError(
                "A simulator's process does not answer.",
                got=f"nothing within {WORKER_TIMEOUT_S:.0f} s",
                allowed="an answer within that time",
                hint="adamanip doctor; --eval.use_async_envs=false shows where it stands",
            ) from error
        except BaseException as error:
            traceback.clear_frames(error.__traceback__)
            self._stop(at_once=True)
            raise


def _ending(code: int) -> str:
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with status {code}"


_server = forkserver.ForkServer()
"""Fork server of the simulators alone: the caller's other processes inherit neither its modules nor its environment."""


def start_server() -> None:
    """Starts the process that imports the simulator once and is then copied for each environment.

    Otherwise each environment imports the simulator, which takes 4 s of CPU time.
    """
    _server.set_forkserver_preload(PRELOADED)
    with thread_limits():
        _server.ensure_running()


@contextlib.contextmanager
def _server_in_use() -> Iterator[None]:
    """Lets the standard library fork from our server; it has no option for that."""
    start_server()  # again, if it was killed
    usual, forkserver.connect_to_new_process = forkserver.connect_to_new_process, _server.connect_to_new_process
    try:
        yield
    finally:
        forkserver.connect_to_new_process = usual


def make_vector_env(
    options: EnvironmentOptions, n_envs: int, use_async_envs: bool, names: Mapping[str, str]
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Returns ``n_envs`` equal environments as one, with clouds (3 N,); an ended one waits until the next reset.

    ``names`` renames cameras, see `contract.cameras.camera_names`.
    """
    from lerobot.envs.utils import freeze_after_episode_end  # LeRobot's server imports this module without it

    if n_envs < 1:
        raise ConfigurationError(
            "Wrong number of environments.", got=n_envs, allowed=">= 1", hint="--eval.batch_size=2"
        )
    check_repeats(options, n_envs)
    _log.info(
        "%s: %s scenes, %s objects%s.",
        *(options.category, options.split, options.objects),
        "" if options.split == "test" else " (for a test result: --env.split=test)",
    )
    makers = [freeze_after_episode_end(functools.partial(_make, options, dict(names)))] * n_envs
    # Simulators in one process would render one after the other; separate processes use all cores.
    return AsyncSimulators(makers) if use_async_envs and n_envs > 1 else SyncSimulators(makers)


def check_repeats(options: EnvironmentOptions, n_envs: int) -> None:
    """Raises `ConfigurationError` if several environments are to repeat a scene: their seeds are not in a row."""
    if n_envs > 1 and options.repeats > 1:
        raise ConfigurationError(
            "Repeats of a scene play one after the other, in one environment.",
            got=f"repeats={options.repeats} in {n_envs} environments",
            allowed="one environment",
            hint="--eval.batch_size=1",
        )


def _new_rollout(options: dict[str, Any] | None) -> dict[str, Any]:
    return {**(options or {}), NEW_ROLLOUT: True}


def _make(options: EnvironmentOptions, names: Mapping[str, str]) -> gym.Env[Any, Any]:
    env: Any = make_environment(options)
    env = FailMalformedActions(env)
    env = FlatCloud(env) if options.observes_cloud else env
    renamed = options.observe_images and any(name != camera for camera, name in names.items())
    return CameraNames(env, names) if renamed else env
