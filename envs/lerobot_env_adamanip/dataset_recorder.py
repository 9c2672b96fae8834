"""Recording of a user's own policy or expert as a dataset, in the format of `adamanip collect`."""

from __future__ import annotations

import contextlib
import json
import logging
import re
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.collection.assemble import Contents, assemble
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Goal, Phase
from lerobot_adamanip.contract.memory import NO_MEMORY
from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.contract.versions import DATA_VERSION, SIMULATION_VERSION, cpu_model
from lerobot_adamanip.datasets.collection_spec import SPLIT, environment_json
from lerobot_adamanip.datasets.episode import EpisodeDescription
from lerobot_adamanip.datasets.output_folder import RECORDING, owned_output
from lerobot_adamanip.datasets.shards import RecordedEpisode, write_shard
from lerobot_adamanip.episode.memory import with_row_tasks
from lerobot_adamanip.episode.rollout import EpisodeRecorder, KeyFrame
from lerobot_adamanip.hardware.features import UNLABELLED
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_env_adamanip.keyframe_env import KeyframeEnv, Observation

_log = logging.getLogger(__name__)


class DatasetRecorder(gym.Wrapper[Any, Any, Any, Any]):
    """Records each episode of a `KeyframeEnv` that is stepped through it; `save` makes the dataset.

    An episode is written when it ends, and when the next reset or `save` cuts it short. A killed program loses only the
    episode in progress: the same program continues in the same folder. The column ``action`` holds the commanded
    actions, with orthonormal rotations. Episodes are kept with and without success; ``adamanip filter --where
    success=true`` selects.

    Use one recorder per folder, and one environment per recorder. Attributes of `KeyframeEnv`, such as ``feedback``,
    can be read from the recorder.

    Args:
        env: environment, or a wrapper around it that changes neither actions nor observations.
        root: folder of the new dataset.
        recorded_by: name of the policy or expert, for the column ``expert``.
        repo_id: repository id in the dataset card; ``local/<folder name>`` by default.

    Raises:
        DatasetError: the folder has other content, or episodes of other options or versions.
    """

    def __init__(
        self, env: gym.Env[Any, Any], root: str | Path, *, recorded_by: str, repo_id: str | None = None
    ) -> None:
        super().__init__(env)
        if not isinstance(env.unwrapped, KeyframeEnv) or env.unwrapped.options.is_dense:
            raise ConfigurationError(
                "Only key-frame environments can be recorded.",
                got=type(env.unwrapped).__name__,
                allowed="KeyframeEnv, or a wrapper around it",
                hint="DatasetRecorder(KeyframeEnv('safe'), 'outputs/mine', recorded_by='my policy'); at control rate: "
                "adamanip collect DIR --control dense",
            )
        self._env = env.unwrapped
        if not re.fullmatch(r"[\w .:+-]{1,80}", recorded_by):
            raise ConfigurationError(
                "Wrong name of a policy.",
                got=repr(recorded_by),
                allowed="1 to 80 letters, digits, spaces and . : + -",
                hint="recorded_by='my policy'",
            )
        self._recorded_by = recorded_by
        if self._env.options.split != SPLIT:
            split = self._env.options.split
            _log.warning("Recording %s scenes. For a dataset to train on: KeyframeEnv(..., split='train').", split)
        self._stack = contextlib.ExitStack()
        self._output = self._stack.enter_context(owned_output(root, RECORDING))
        self._repo_id = repo_id or f"local/{self._output.root.name}"
        self._recorder: EpisodeRecorder | None = None
        self._observation: Observation = {}
        self._overrides: dict[str, Any] | None = None
        self._is_open = True
        try:
            self._output.require_free()
            self._begin()
        except BaseException:
            self._stack.close()
            raise

    def __getattr__(self, name: str) -> Any:
        """Returns an attribute of the environment, so that `rollout` and experts can use the recorder."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._env, name)

    @property
    def episodes(self) -> int:
        """Number of recorded episodes, including those of earlier runs, and any whose damaged file was deleted."""
        shards = self._shards()
        return int(shards[-1].stem) + 1 if shards else 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Writes the episode before, if it was cut short, and starts the next one.

        Raises:
            DatasetError: the recorder is closed.
        """
        self._require_open()
        self._write()
        observation, info = self.env.reset(seed=seed, options=options)
        self._observation, self._overrides = observation, (options or {}).get("hidden_overrides")
        self._recorder = EpisodeRecorder(self._env.joints)
        return observation, info

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Steps the environment and records the key frame; writes the episode at its end."""
        following, reward, terminated, truncated, info = self.env.step(action)
        if self._recorder is not None:
            pose, gripper = pose_from_vector(np.array(action, np.float64))
            goal = Goal(pose, float(np.clip(gripper, 0.0, 1.0)), cast("Phase", UNLABELLED))
            labels = self._env.labels
            # A memory is of the action as it was sent, before its rotation is made orthonormal.
            sent = None if self._env.options.memory == NO_MEMORY else np.array(action, np.float32)
            self._recorder.record(
                KeyFrame(self._observation, goal, self._env.feedback, following, info["is_success"], labels, sent)
            )
            self._observation = following
            if terminated or truncated:
                self._write()
        return following, float(reward), terminated, truncated, info

    def save(self) -> Path:
        """Makes the dataset of all recorded episodes and returns its folder. The recorder is then closed for recording.

        Raises:
            DatasetError: no episode was recorded, the dataset cannot be written, or the recorder is closed.
        """
        self._require_open()
        self._write()
        contents = Contents(self._shards(), self._env.options, self._repo_id)
        built = assemble(self._output.fresh("dataset"), self._output.root.name, contents)
        self._output.publish(built)
        self._is_open = False
        self._stack.close()
        return self._output.root

    def close(self) -> None:
        """Writes an episode that was cut short, and closes the environment. A new recorder continues in the folder."""
        self._write()
        self._is_open = False
        self._stack.close()
        super().close()

    def _require_open(self) -> None:
        if not self._is_open:
            raise DatasetError(
                "This recorder is closed.",
                got=f"a recorder of {self._output.root} after save() or close()",
                allowed="reset and save before that",
                hint="a new DatasetRecorder; after save() in another folder",
            )

    def _begin(self) -> None:
        """Creates the folder of episodes, or checks that its episodes have the same options and versions."""
        path, folder = self._output.work / "recording.json", self._output.work / "episodes"
        own = {
            "environment": environment_json(self._env.options),
            "category": self._env.category,
            "versions": self._env.software_versions(),
        }
        content = json.dumps(own, sort_keys=True, indent=2).encode()
        folder.mkdir(exist_ok=True)
        files.remove_temporaries(folder)
        if self._shards() and (not path.exists() or path.read_bytes() != content):
            raise DatasetError(
                "This folder has episodes that were recorded with other options or versions.",
                got=f"{self.episodes} episodes in {self._output.work}",
                allowed="the same environment options and versions for all episodes of a dataset",
                hint="another folder; or the program of before, to save those episodes",
            )
        files.write_atomically(path, content)

    def _shards(self) -> list[Path]:
        return sorted((self._output.work / "episodes").glob("*.safetensors"))

    def _write(self) -> None:
        """Writes the episode in progress durably; one without a key frame is dropped."""
        recorder, self._recorder = self._recorder, None
        if recorder is None or not recorder.rows:
            return
        env, number = self._env, self.episodes
        episode_record = env.episode_record()
        columns = recorder.columns()
        description = EpisodeDescription(
            object_id=episode_record["object_id"],
            seed=episode_record["seed"],
            expert=self._recorded_by,
            tries=len(episode_record["try_sequence"]),
            failed_tries=sum(failed for _, _, failed in episode_record["try_sequence"]),
            success=bool(columns[schema.SUCCESS].any()),
            slot=number,
            simulation_version=SIMULATION_VERSION,
            data_version=DATA_VERSION,
            hidden_state=env.hidden_state(),
            hidden_overrides=None if self._overrides is None else dict(self._overrides),
            camera=env.camera_parameters(),
            versions={**env.software_versions(), "cpu": cpu_model()},
            episode_record=episode_record,
        )
        record = with_row_tasks(description.record(env.task_description), columns, env.options)
        episode = RecordedEpisode(columns, record)
        write_shard(self._output.work / "episodes" / f"{number:06d}.safetensors", episode)
