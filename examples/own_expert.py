"""An expert of one's own: a generator that yields key frames and is sent what the arm felt.

This one pulls a microwave's door, and if it does not come along, goes and pushes the button: trial and error is
ordinary control flow. `python examples/own_expert.py`
"""

from __future__ import annotations

from collections.abc import Mapping

from lerobot_adamanip.contract.keyframes import Goal, KeyFrames, Phase
from lerobot_adamanip.episode.rollout import rollout
from lerobot_adamanip.experts.primitives import before
from lerobot_adamanip.objects import PartAnnotation
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

PULLS, PUSH = (0.17, 0.38, 0.58, 0.73), 0.03
"""Door angles [rad], and how far the button is pushed [m]."""


def expert(parts: Mapping[str, PartAnnotation]) -> KeyFrames:
    handle, button = parts["handle"], parts["button"]
    for _ in range(2):
        yield Goal(before(handle.grasp), 1.0, Phase.APPROACH)
        yield Goal(handle.grasp, 1.0, Phase.APPROACH)
        yield Goal(handle.grasp, 0.0, Phase.GRASP)
        for angle in PULLS:
            felt = yield Goal(handle.moved({"door": angle}), 0.0, Phase.TRY)
            if felt.failed:
                break  # the door did not come along: it may be locked
        else:
            return
        yield Goal(felt.tcp_in_base, 1.0, Phase.RELEASE)
        yield Goal(before(felt.tcp_in_base), 1.0, Phase.RELEASE)
        for pose in (before(button.grasp), button.grasp, button.moved({"button": PUSH}), before(button.grasp)):
            yield Goal(pose, 0.0, Phase.UNLOCK)


def main() -> None:
    print("starting the simulator ...", flush=True)
    env = KeyframeEnv("microwave", objects="0:4", observe_images=False)
    for locked in (False, True):
        observation, _ = env.reset(seed=7, options={"hidden_overrides": {"locked": locked}})
        result = rollout(env, observation, expert(env.annotations))
        print(f"locked {locked}: {result.reason} after {result.key_frames} key frames", flush=True)
    env.close()


if __name__ == "__main__":
    main()
