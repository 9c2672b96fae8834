"""Vector environments for LeRobot's rollouts: ended episodes wait, processes start lazily, hanging ones raise errors.

LeRobot 0.6.1 has similar ones under private names.
"""

from __future__ import annotations

import logging
import multiprocessing
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym

from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.util.errors import ConfigurationError, SimulatorError
from lerobot_adamanip.util.jobs import preload
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

_log = logging.getLogger(__name__)

Make = Callable[[], gym.Env[Any, Any]]
Transition = tuple[Any, float, bool, bool, dict[str, Any]]
WORKER_TIMEOUT_S = 600.0
"""Time limit of an answer [s]: a reset takes seconds, the first one a minute."""


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


class FreezeAfterEpisodeEnd(gym.Wrapper[Any, Any, Any, Any]):
    """Repeats an ended episode's last observation, without reward, until a rollout starts the next episode.

    LeRobot steps a batch until its slowest environment has ended. Gymnasium resets an ended one without seed and
    options; a rollout passes one of them.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self._last: Transition | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode if seed or options are given; otherwise returns the last observation."""
        if self._last is not None and seed is None and not options:
            return self._last[0], self._last[4]
        self._last = None
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> Transition:
        """Steps the environment, or repeats the last observation after the end."""
        if self._last is not None:
            return self._last
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            self._last = (observation, 0.0, terminated, truncated, info)
        return observation, float(reward), terminated, truncated, info


class LazyAsyncVectorEnv:
    """Runs one process per environment, started at first use and ended by `close`; can be used again afterwards.

    A suite therefore runs the processes of one category at a time. ``makers`` must be picklable by cloudpickle.
    """

    def __init__(self, makers: Sequence[Make]) -> None:
        preload("lerobot_env_adamanip.fork_server_preload")  # while the caller loads a policy
        self._makers = list(makers)
        self._env: gym.vector.AsyncVectorEnv | None = None
        self.num_envs = len(self._makers)
        first = self._makers[0]()  # does not start the simulator
        self.single_observation_space = self.observation_space = first.observation_space
        self.single_action_space = self.action_space = first.action_space
        self.metadata = first.metadata
        first.close()

    @property
    def unwrapped(self) -> LazyAsyncVectorEnv:
        """Returns itself."""
        return self

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets like `gymnasium.vector.VectorEnv.reset`; raises `SimulatorError` if a process hangs."""
        env = self._started()
        env.reset_async(seed=seed, options=options)
        return self._answer(lambda: env.reset_wait(timeout=WORKER_TIMEOUT_S))

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Steps like `gymnasium.vector.VectorEnv.step`; raises `SimulatorError` if a process hangs."""
        env = self._started()
        env.step_async(actions)
        return self._answer(lambda: env.step_wait(timeout=WORKER_TIMEOUT_S))

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Calls a method, or reads an attribute, of each environment."""
        return self._started().call(name, *args, **kwargs)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Reads an attribute of each environment."""
        return self._started().get_attr(name)

    def close(self) -> None:
        """Ends the processes."""
        env, self._env = self._env, None
        if env is not None:
            env.close()

    def _started(self) -> gym.vector.AsyncVectorEnv:
        if self._env is None:
            self._env = gym.vector.AsyncVectorEnv(
                [_frozen(make) for make in self._makers],
                context="forkserver",
                shared_memory=True,
                autoreset_mode=gym.vector.AutoresetMode.NEXT_STEP,
            )
        return self._env

    def _answer[T](self, wait: Callable[[], T]) -> T:
        try:
            return wait()
        except multiprocessing.TimeoutError as error:
            env, self._env = self._env, None
            if env is not None:
                env.close(terminate=True)
            raise SimulatorError(
                "A simulator's process does not answer.",
                got=f"nothing within {WORKER_TIMEOUT_S:.0f} s",
                allowed="an answer within that time",
                hint="adamanip doctor; --eval.use_async_envs=false shows where it stands",
            ) from error


type VectorEnv = gym.vector.VectorEnv[Any, Any, Any] | LazyAsyncVectorEnv


def make_vector_env(options: EnvironmentOptions, n_envs: int, use_async_envs: bool) -> VectorEnv:
    """Returns ``n_envs`` equal environments as one, with clouds (3 N,); an ended one waits until the next rollout."""
    if n_envs < 1:
        raise ConfigurationError(
            "Wrong number of environments.", got=n_envs, allowed=">= 1", hint="--eval.batch_size=2"
        )
    _log.info(
        "%s: %s scenes, %s objects%s.",
        *(options.category, options.split, options.objects),
        "" if options.split == "test" else " (for a test result: --env.split=test)",
    )
    functions = [lambda: FlatCloud(KeyframeEnv(options=options))] * n_envs
    # Simulators in one process would render one after the other; separate processes use all cores.
    if use_async_envs and n_envs > 1:
        return LazyAsyncVectorEnv(functions)
    return gym.vector.SyncVectorEnv(
        [_frozen(function) for function in functions],
        autoreset_mode=gym.vector.AutoresetMode.NEXT_STEP,
    )


def _frozen(make: Make) -> Make:
    return lambda: FreezeAfterEpisodeEnd(make())
