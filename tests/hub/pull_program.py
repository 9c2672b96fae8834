"""Run in a process of its own: calls of LeRobot that take something from the Hub, each with what came of it.

Its argument is a JSON list of [what, options]; its last line a JSON list of ``{"found": ...}`` or ``{"error": ...}``.
"""

from __future__ import annotations

import json
import sys
import traceback
from typing import Any


def dataset(name: str, **options: Any) -> Any:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    found = LeRobotDataset(name, video_backend="pyav", **options)
    cloud = found[0]["observation.point_cloud"]
    return {"root": str(found.root), "rows": len(found), "episodes": found.num_episodes, "cloud": cloud.sum().item()}


def stream(name: str, **options: Any) -> Any:
    from lerobot.datasets.streaming_dataset import StreamingLeRobotDataset

    return sum(1 for _ in StreamingLeRobotDataset(name, shuffle=False, buffer_size=1, **options))


def policy(name: str) -> Any:
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    import lerobot_env_adamanip  # noqa: F401  (registers it, as lerobot's commands do)

    config = PreTrainedConfig.from_pretrained(name)
    made = get_policy_class(config.type).from_pretrained(name, config=config)
    pipelines = make_pre_post_processors(config, pretrained_path=name)
    return [sum(each.double().sum().item() for each in made.parameters()), [len(each.steps) for each in pipelines]]


def environment(name: str, trust: bool = True) -> Any:
    from lerobot.envs.factory import make_env

    envs = make_env(name, n_envs=2, use_async_envs=True, trust_remote_code=trust)
    return {suite: {task: vec.num_envs for task, vec in tasks.items()} for suite, tasks in envs.items()}


CALLS = {"dataset": dataset, "stream": stream, "policy": policy, "environment": environment}


def main() -> None:
    came = []
    for what, options in json.loads(sys.argv[1]):
        try:
            came.append({"found": CALLS[what](**options)})
        except Exception as error:
            traceback.print_exc()
            came.append({"error": f"{type(error).__name__}: {error}"})
    print(json.dumps(came))


if __name__ == "__main__":
    main()
