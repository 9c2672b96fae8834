"""A session on the simulated twin with LeRobot's own commands: record, teleoperate, replay, learn, roll out.

    python scripts/check_twin_session.py --out outputs/twin --episodes 10
    python scripts/check_twin_session.py --out outputs/twin --policy CHECKPOINT/pretrained_model --seeds 20

Records microwaves in lockstep through the scripted teleoperator (which of them are locked is drawn from their seeds),
teleoperates in real time, and replays an episode that opened its door in a twin of the same seed. Makes key frames of
the recording, plays them again in the scenes of their seeds, and trains on them and simulated demonstrations together.
With ``--policy``, `lerobot-rollout` plays each seed in key frames, and `lerobot-eval` plays the same seeds. What came
of each is read from the logs that the twin writes beside its datasets. Interrupted, the same command goes on.

Returns 1 unless 9 of 10 recorded doors opened, both kinds were recorded, the replay opened its door, key frames are
described as simulated demonstrations are and hold accepted targets, 8 of 10 of them open their door again, the loss
falls by half, and the roll-outs' success lies in the 95 % Wilson interval of the evaluation's.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import twin_learning
from check_common import ROOT, count, header

from lerobot_adamanip.evaluation.rates import wilson_interval
from lerobot_adamanip.util import files
from lerobot_adamanip.util.json_fields import parse

STAGES = "stages.json"
"""What came of each part of a session: the same command goes on where it was interrupted."""
SHARE_OPENED = 0.9
"""Of the recorded doors that have to be open."""
ENDLESS = 24 * 3600
"""The scripted teleoperator ends an episode; LeRobot's clock should not [s]."""
TWIN = ("--robot.type=adamanip_franka_sim", "--robot.id=twin", "--robot.category=microwave", "--robot.split=test")
QUIET = ("--play_sounds=false",)


class Session:
    """Runs LeRobot's commands of this environment, each with a log of its own.

    Args:
        out: folder for datasets and logs.
    """

    def __init__(self, out: Path) -> None:
        self.out = out
        kept = out / STAGES
        self._stages: dict[str, dict[str, Any]] = parse(kept.read_text(encoding="utf-8")) if kept.exists() else {}
        self.commands: list[dict[str, Any]] = [each for stage in self._stages.values() for each in stage["commands"]]

    def stage(self, name: str, work: Callable[[], Any], *makes: str) -> Any:
        """Returns what came of a part of the session: what is kept of an earlier run, or else that of the work now.

        Args:
            name: of the part.
            work: does it.
            makes: files and folders that a part which was interrupted has left, and that it begins anew.
        """
        if name not in self._stages:
            for path in (self.out / each for each in makes):
                if path.is_dir():
                    files.remove_tree(path)
                path.unlink(missing_ok=True)
            before = len(self.commands)
            found = work()
            self._stages[name] = {"found": found, "commands": self.commands[before:]}
            files.write_atomically(self.out / STAGES, json.dumps(self._stages, indent=1).encode())
        return self._stages[name]["found"]

    def run(self, program: str, *arguments: str) -> Path:
        """Runs a program and returns its log; raises RuntimeError with the end of that where it fails."""
        command = [str(Path(sys.executable).with_name(program)), *arguments]
        log = self.out / f"{len(self.commands):02d}-{program}.log"
        sys.stderr.write(f"{program} {' '.join(arguments)}\n")
        started = time.monotonic()
        with log.open("wb") as file:
            done = subprocess.run(command, cwd=ROOT, stdout=file, stderr=subprocess.STDOUT, check=False)
        seconds = round(time.monotonic() - started, 1)
        self.commands.append({"command": [program, *arguments], "seconds": seconds, "log": log.name})
        if done.returncode:
            raise RuntimeError(f"{program} failed, see {log}:\n{log.read_text(errors='replace')[-2000:]}")
        return log


def lines_of(log: Path) -> list[dict[str, Any]]:
    """Returns the episodes of a twin's log, the last line of each number."""
    found = [parse(line) for line in log.read_text(encoding="utf-8").splitlines()]
    return list({line["episode"]: line for line in found}.values())


def record(session: Session, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Records episodes and returns what the twin says of them."""
    root = session.out / "recorded"
    session.run(
        "lerobot-record",
        *TWIN,
        "--robot.clock=lockstep",
        f"--robot.seed={options.seed}",
        f"--robot.image_size={options.image_size}",
        "--teleop.type=adamanip_scripted",
        "--dataset.repo_id=local/twin",
        f"--dataset.root={root}",
        f"--dataset.num_episodes={options.episodes}",
        f"--dataset.episode_time_s={ENDLESS}",
        "--dataset.reset_time_s=0",
        "--dataset.single_task=Open the microwave.",
        "--dataset.push_to_hub=false",
        *QUIET,
    )
    return lines_of(root.with_name("recorded.episodes.jsonl"))


def teleoperate(session: Session, options: argparse.Namespace) -> dict[str, Any]:
    """Drives the twin in real time for a while."""
    log = session.out / "teleoperated.jsonl"
    session.run(
        "lerobot-teleoperate",
        *TWIN,
        f"--robot.seed={options.seed}",
        f"--robot.episode_log={log}",
        "--teleop.type=adamanip_scripted",
        "--fps=30",
        f"--teleop_time_s={options.teleoperate}",
    )
    return lines_of(log)[-1]


def replay(session: Session, options: argparse.Namespace, episode: int) -> dict[str, Any]:
    """Replays one recorded episode in the scene that it was recorded in."""
    log = session.out / "replayed.jsonl"
    session.run(
        "lerobot-replay",
        *TWIN,
        "--robot.clock=lockstep",
        "--robot.camera=false",
        f"--robot.seed={options.seed + episode}",
        f"--robot.episode_log={log}",
        "--dataset.repo_id=local/twin",
        f"--dataset.root={session.out / 'recorded'}",
        f"--dataset.episode={episode}",
        *QUIET,
    )
    return lines_of(log)[-1]


def roll_out(session: Session, options: argparse.Namespace) -> dict[str, Any]:
    """Plays each seed with a policy: by `lerobot-rollout` on the twin, and by `lerobot-eval`."""
    log = session.out / "rolled_out.jsonl"

    def play(seed: int) -> bool:
        session.run(
            "lerobot-rollout",
            *TWIN,
            "--robot.clock=lockstep",
            "--robot.execution=keyframe",
            "--robot.end_when_done=true",
            f"--robot.seed={seed}",
            f"--robot.episode_log={log}",
            f"--policy.path={options.policy}",
            "--task=Open the microwave.",
            f"--duration={ENDLESS}",
            "--return_to_initial_position=false",
            *QUIET,
        )
        return bool(lines_of(log)[-1]["success"])

    seeds = range(options.seed, options.seed + options.seeds)
    won = sum(session.stage(f"roll-out {seed}", partial(play, seed)) for seed in seeds)
    return session.stage("evaluation", lambda: _against_evaluation(session, options, won), "evaluated.jsonl")


def _against_evaluation(session: Session, options: argparse.Namespace, won: int) -> dict[str, Any]:
    evaluated = session.out / "evaluated.jsonl"
    session.run(
        "lerobot-eval",
        f"--policy.path={options.policy}",
        "--env.type=adamanip_microwave",
        "--env.split=test",
        "--env.observe_images=false",
        f"--env.episode_log={evaluated}",
        f"--seed={options.seed}",
        f"--eval.n_episodes={options.seeds}",
        "--eval.batch_size=1",
        f"--output_dir={session.out / 'evaluated'}",
    )
    expected = sum(bool(parse(line)["success"]) for line in evaluated.read_text(encoding="utf-8").splitlines())
    low, high = wilson_interval(expected, options.seeds)
    return {
        "rolled_out": won,
        "evaluated": expected,
        "seeds": options.seeds,
        "interval": [low, high],
        "agrees": low <= won / options.seeds <= high,
    }


def learn(session: Session, options: argparse.Namespace, episodes: list[dict[str, Any]]) -> dict[str, Any]:
    """Makes key frames of what was recorded, plays them again, and trains on them and simulated ones."""
    names = ("recorded", "simulated", "converted")
    recorded, simulated, converted = (session.out / name for name in names)
    session.stage("key frames", lambda: twin_learning.convert(session.run, recorded, simulated, converted), *names[1:])
    seeds = {each["episode"]: each["given_seed"] for each in episodes}
    opened, count_of = session.stage("played again", lambda: twin_learning.played_again(converted, seeds))
    losses = session.stage(
        "training",
        lambda: twin_learning.mixed_training(session.run, recorded, simulated, session.out, options.steps),
        "mix",
        "trained",
    )
    ends = sum(losses[-3:]) / 3
    return {
        "same_description": twin_learning.same_description(simulated, converted),
        "accepted_targets": twin_learning.accepted_targets(recorded, converted),
        "played_again": count_of,
        "opened_again": opened,
        "opened_enough": opened >= twin_learning.SHARE_REPLAYED * count_of,
        "loss": [losses[0], round(ends, 4)],
        "loss_halves": ends <= losses[0] / 2,
    }


def judged(episodes: list[dict[str, Any]], replayed: dict[str, Any] | None) -> dict[str, Any]:
    """Returns what recording and replay have shown."""
    locked = [bool(each["hidden_state"]["locked"]) for each in episodes]
    opened = sum(bool(each["success"]) for each in episodes)
    return {
        "episodes": len(episodes),
        "locked": sum(locked),
        "opened": opened,
        "both_kinds": len(set(locked)) == 2,
        "enough": opened >= SHARE_OPENED * len(episodes),
        "replay_opened": None if replayed is None else bool(replayed["success"]),
    }


def main(arguments: list[str] | None = None) -> int:
    """Runs the session and writes ``result.json``."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for datasets, logs and result.json")
    parser.add_argument("--episodes", type=count, default=10)
    parser.add_argument("--seed", type=int, default=1000, help="of the first episode")
    parser.add_argument("--image-size", type=count, default=256)
    parser.add_argument("--teleoperate", type=float, default=10.0, metavar="SECONDS")
    parser.add_argument("--steps", type=count, default=twin_learning.STEPS, help="of the mixed training (%(default)s)")
    parser.add_argument("--policy", type=Path, help="checkpoint whose preprocessor makes clouds from depth")
    parser.add_argument("--seeds", type=count, default=20, help="of roll-outs")
    parser.add_argument("--json", action="store_true", help="print the result")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    # All of it runs in the repository's root, so that commands are told as others could type them.
    options.out, options.policy = (each and Path(os.path.relpath(each, ROOT)) for each in (options.out, options.policy))
    os.chdir(ROOT)
    session = Session(options.out)
    episodes = session.stage("recording", lambda: record(session, options), "recorded", "recorded.episodes.jsonl")
    driven = session.stage("teleoperation", lambda: teleoperate(session, options), "teleoperated.jsonl")
    opened = [each["episode"] for each in episodes if each["success"]]
    replayed = session.stage(
        "replay", lambda: replay(session, options, opened[0]) if opened else None, "replayed.jsonl"
    )
    learnt = learn(session, options, episodes)
    result = {**header(), **judged(episodes, replayed), "teleoperated_s": driven["seconds"], "learnt": learnt}
    passed = all(result[name] for name in ("enough", "both_kinds", "replay_opened"))
    passed = passed and all(learnt[name] for name in ("same_description", "accepted_targets", "opened_enough"))
    passed = passed and learnt["loss_halves"]
    if options.policy is not None:
        result["roll_outs"] = roll_out(session, options)
        passed = passed and result["roll_outs"]["agrees"]
    text = json.dumps({**result, "commands": session.commands, "passed": passed}, indent=2)
    files.write_atomically(options.out / "result.json", text.encode())
    if options.json:
        sys.stdout.write(text + "\n")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
