"""Runs a session on the simulated twin with LeRobot's commands: record, teleoperate, replay, train, roll out.

    python scripts/check_twin_session.py --out outputs/twin --episodes 10
    python scripts/check_twin_session.py --out outputs/twin --policy CHECKPOINT/pretrained_model --seeds 20

Records microwaves in lockstep with the scripted teleoperator. Teleoperates in real time, replays an episode, makes
key frames, plays them again in their scenes, and trains on them and simulated demonstrations. With ``--policy``,
`lerobot-rollout` and `lerobot-eval` run the same seeds.

Returns 1 unless all of these hold: 9 of 10 recorded doors opened, both locked and free ones; the replay opened its
door; the key frames have the metadata of simulated demonstrations and accepted targets; 8 of 10 open their door again;
the loss falls by half; the rollouts' success is in the evaluation's 95 % Wilson interval.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from check_common import ROOT, count, header

from lerobot_adamanip.contract import schema
from lerobot_adamanip.evaluation.rates import wilson_interval
from lerobot_adamanip.hardware.features import ARM, ARM_NAMES, SENT_NAMES
from lerobot_adamanip.util import files
from lerobot_adamanip.util.json_fields import parse, read
from lerobot_policy_adamanip.common.inputs import read_columns

SHARE_OPENED, SHARE_REPLAYED = 0.9, 0.8
"""Minimum shares of opened doors: in recordings, and in converted episodes played again."""
ENDLESS = 24 * 3600
"""Maximum duration of an episode [s]. The scripted teleoperator should end it earlier."""
TWIN = ("--robot.type=adamanip_franka_sim", "--robot.id=twin", "--robot.category=microwave", "--robot.split=test")
LOCKSTEP, QUIET, DATASET = "--robot.clock=lockstep", "--play_sounds=false", "--dataset.repo_id=local/twin"
Run = Callable[..., Path]
"""(program, arguments...) -> log of its output. Raises RuntimeError if it fails."""


class Session:
    """Runs commands of this environment, each with a log in ``out``."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.commands: list[dict[str, Any]] = []

    def run(self, program: str, *arguments: str) -> Path:
        """Runs a program and returns its log. On failure, raises RuntimeError with the end of the log."""
        log = self.out / f"{len(self.commands):02d}-{program}.log"
        sys.stderr.write(f"{program} {' '.join(arguments)}\n")
        started = time.monotonic()
        with log.open("wb") as file:
            command = [str(Path(sys.executable).with_name(program)), *arguments]
            done = subprocess.run(command, cwd=ROOT, stdout=file, stderr=subprocess.STDOUT, check=False)
        seconds = round(time.monotonic() - started, 1)
        self.commands.append({"command": [program, *arguments], "seconds": seconds, "log": log.name})
        if done.returncode:
            raise RuntimeError(f"{program} failed, see {log}:\n{log.read_text(errors='replace')[-2000:]}")
        return log


def lines_of(log: Path) -> list[dict[str, Any]]:
    """Returns the episodes of a twin's log, with the last line per number."""
    lines = [parse(line) for line in log.read_text(encoding="utf-8").splitlines()]
    return list({line["episode"]: line for line in lines}.values())


def record(session: Session, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Records episodes and returns the twin's log of them."""
    root = session.out / "recorded"
    robot = (
        *TWIN,
        LOCKSTEP,
        f"--robot.seed={options.seed}",
        f"--robot.image_size={options.image_size}",
        "--robot.depth=true",
    )
    data = (DATASET, f"--dataset.root={root}", f"--dataset.num_episodes={options.episodes}")
    times = (f"--dataset.episode_time_s={ENDLESS}", "--dataset.reset_time_s=0")
    rest = ("--dataset.single_task=Open the microwave.", "--dataset.push_to_hub=false", QUIET)
    session.run("lerobot-record", *robot, "--teleop.type=adamanip_scripted", *data, *times, *rest)
    return lines_of(root.with_name("recorded.episodes.jsonl"))


def teleoperate(session: Session, options: argparse.Namespace) -> float:
    """Drives the twin in real time and returns its elapsed time [s]."""
    log = session.out / "teleoperated.jsonl"
    robot = (*TWIN, f"--robot.seed={options.seed}", f"--robot.episode_log={log}")
    teleop = ("--teleop.type=adamanip_scripted", "--fps=30", f"--teleop_time_s={options.teleoperate}")
    session.run("lerobot-teleoperate", *robot, *teleop)
    return float(lines_of(log)[-1]["seconds"])


def replay(session: Session, options: argparse.Namespace, episode: int) -> bool:
    """Replays a recorded episode in its scene. Returns whether the door opened."""
    log = session.out / "replayed.jsonl"
    robot = (*TWIN, LOCKSTEP, f"--robot.seed={options.seed + episode}", f"--robot.episode_log={log}")
    data = (DATASET, f"--dataset.root={session.out / 'recorded'}", f"--dataset.episode={episode}")
    session.run("lerobot-replay", *robot, "--robot.camera=false", *data, QUIET)
    return bool(lines_of(log)[-1]["success"])


def roll_out(session: Session, options: argparse.Namespace) -> dict[str, Any]:
    """Runs a policy on each seed, with `lerobot-rollout` on the twin and with `lerobot-eval`."""
    log, evaluated, won = session.out / "rolled_out.jsonl", session.out / "evaluated.jsonl", 0
    for seed in range(options.seed, options.seed + options.seeds):
        robot = (*TWIN, LOCKSTEP, f"--robot.seed={seed}", f"--robot.episode_log={log}")
        ending = ("--robot.execution=keyframe", "--robot.end_when_done=true", f"--duration={ENDLESS}")
        policy = (f"--policy.path={options.policy}", "--task=Open the microwave.")
        session.run("lerobot-rollout", *robot, *ending, *policy, "--return_to_initial_position=false", QUIET)
        won += bool(lines_of(log)[-1]["success"])
    env = ("--env.type=adamanip_microwave", "--env.split=test", "--env.observe_images=false")
    episodes = (f"--seed={options.seed}", f"--eval.n_episodes={options.seeds}", "--eval.batch_size=1")
    out = (f"--env.episode_log={evaluated}", f"--output_dir={session.out / 'evaluated'}")
    session.run("lerobot-eval", f"--policy.path={options.policy}", *env, *episodes, *out)
    expected = sum(bool(parse(line)["success"]) for line in evaluated.read_text(encoding="utf-8").splitlines())
    low, high = wilson_interval(expected, options.seeds)
    rates = {"rolled_out": won, "evaluated": expected, "seeds": options.seeds, "interval": [low, high]}
    return {**rates, "agrees": low <= won / options.seeds <= high}


def learn(session: Session, options: argparse.Namespace, episodes: list[dict[str, Any]]) -> dict[str, Any]:
    """Converts the recording to key frames, plays them again, and trains on them and simulated ones."""
    recorded, simulated, converted = (session.out / name for name in ("recorded", "simulated", "converted"))
    session.run("adamanip", "keyframes", str(recorded), "--out", str(converted))
    few = ("--category", "microwave", "--objects", "0:2", "--episodes-per-object", "2")
    session.run("adamanip", "collect", str(simulated), *few)
    opened, played = played_again(converted, {each["episode"]: each["given_seed"] for each in episodes})
    losses = mixed_training(session.run, recorded, simulated, session.out, options.steps)
    ends = float(np.mean(losses[-3:]))
    return {
        "same_description": same_description(simulated, converted),
        "accepted_targets": accepted_targets(recorded, converted),
        "opened_again": opened,
        "played_again": played,
        "opened_enough": opened >= SHARE_REPLAYED * played,
        "loss": [losses[0], round(ends, 4)],
        "loss_halves": ends <= losses[0] / 2,
    }


def same_description(simulated: Path, converted: Path) -> bool:
    """Returns whether both ``meta/info.json`` are equal except counts and camera intrinsics."""

    def content(root: Path) -> dict[str, Any]:
        info = read(root / "meta" / "info.json")
        info["features"][schema.FRONT_IMAGE]["info"].pop("intrinsics", None)
        return {key: value for key, value in info.items() if not key.startswith("total_") and key != "splits"}

    return content(simulated) == content(converted)


def rows_of(root: Path, *columns: str) -> dict[str, Any]:
    """Returns the columns of all rows in order."""
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

    return read_columns(LeRobotDatasetMetadata(f"local/{root.name}", root=root), columns)


def accepted_targets(recorded: Path, converted: Path) -> bool:
    """Returns whether each key frame's action equals, in float32, a target that the arm accepted in its episode."""
    dense = rows_of(recorded, ARM, "episode_index")
    sent = dense[ARM][:, [ARM_NAMES.index(name) for name in SENT_NAMES]].astype(np.float32)
    rows, origin = rows_of(converted, schema.ACTION, schema.DONE, "episode_index"), origins_of(converted)
    for action, done, episode in zip(*rows.values(), strict=True):
        accepted = sent[dense["episode_index"] == origin[int(episode)]]
        pose = np.asarray(action, np.float32)[: schema.GRIPPER_DIM]
        if not done and not (accepted[:, : schema.GRIPPER_DIM] == pose).all(axis=1).any():
            return False
    return True


def origins_of(root: Path) -> list[int]:
    """Returns the recorded episode number of each converted episode."""
    import pyarrow.dataset as pads

    paths = [str(path) for path in sorted((root / "meta" / "episodes").rglob("*.parquet"))]
    rows = pads.dataset(paths).to_table(columns=["episode_index", "recorded"]).to_pylist()
    return [int(json.loads(row["recorded"])["episode"]) for row in rows]


def played_again(converted: Path, seeds: Mapping[int, int]) -> tuple[int, int]:
    """Plays each converted episode in its scene. Returns (number of opened doors, number of episodes)."""
    from lerobot_env_adamanip.keyframe_env import KeyframeEnv

    rows = rows_of(converted, schema.ACTION, schema.DONE, "episode_index")
    env = KeyframeEnv("microwave", split="test", observe_images=False)
    opened, origins = 0, origins_of(converted)
    try:
        for episode, origin in enumerate(origins):
            is_sent = (rows["episode_index"] == episode) & ~rows[schema.DONE].astype(bool).ravel()
            env.reset(seed=seeds[origin])
            for action in rows[schema.ACTION][is_sent]:
                _, _, success, truncated, _ = env.step(np.asarray(action, np.float32))
                if success or truncated:
                    break
            opened += bool(success)
    finally:
        env.close()
    return opened, len(origins)


def mixed_training(run: Run, recorded: Path, simulated: Path, out: Path, steps: int) -> list[float]:
    """Trains on recorded key frames and simulated demonstrations. Returns the logged losses."""
    run("adamanip", "keyframes", str(recorded), str(simulated), "--out", str(out / "mix"))
    policy = ("--policy.type=dp3_adaptive", "--policy.device=cpu", "--policy.push_to_hub=false")
    data = ("--dataset.repo_id=local/mix", f"--dataset.root={out / 'mix'}", "--batch_size=32", "--num_workers=0")
    saving = (f"--save_freq={steps}", f"--log_freq={max(1, steps // 15)}", f"--output_dir={out / 'trained'}")
    log = run("lerobot-train", *policy, *data, f"--steps={steps}", *saving)
    return [float(value) for value in re.findall(r" loss:([0-9.]+)", log.read_text(errors="replace"))]


def main(arguments: list[str] | None = None) -> int:
    """Runs the session and writes ``result.json``."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="new folder for datasets, logs and result.json")
    parser.add_argument("--episodes", type=count, default=10)
    parser.add_argument("--seed", type=int, default=1000, help="seed of the first episode")
    parser.add_argument("--image-size", type=count, default=256)
    parser.add_argument("--teleoperate", type=float, default=10.0, metavar="SECONDS")
    parser.add_argument("--steps", type=count, default=300, help="steps of the mixed training (%(default)s)")
    parser.add_argument("--policy", type=Path, help="checkpoint with a preprocessor that makes clouds from depth")
    parser.add_argument("--seeds", type=count, default=20, help="of roll-outs")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True)
    # Use paths relative to the repository's root, so that others can run the commands in the result.
    options.out, options.policy = (each and Path(os.path.relpath(each, ROOT)) for each in (options.out, options.policy))
    os.chdir(ROOT)
    session = Session(options.out)
    episodes = record(session, options)
    opened = [each["episode"] for each in episodes if each["success"]]
    locked = [bool(each["hidden_state"]["locked"]) for each in episodes]
    result = {
        "episodes": len(episodes),
        "locked": sum(locked),
        "opened": len(opened),
        "both_kinds": len(set(locked)) == 2,
        "enough": len(opened) >= SHARE_OPENED * len(episodes),
        "teleoperated_s": teleoperate(session, options),
        "replay_opened": bool(opened) and replay(session, options, opened[0]),
        "learnt": learn(session, options, episodes),
    }
    learnt = ("same_description", "accepted_targets", "opened_enough", "loss_halves")
    passed = all(result[name] for name in ("enough", "both_kinds", "replay_opened"))
    passed = passed and all(result["learnt"][name] for name in learnt)
    if options.policy is not None:
        result["roll_outs"] = roll_out(session, options)
        passed = passed and result["roll_outs"]["agrees"]
    written = {**header(), **result, "commands": session.commands, "passed": passed}
    files.write_atomically(options.out / "result.json", json.dumps(written, indent=2).encode())
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
