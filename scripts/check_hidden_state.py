"""Checks that nothing hidden shows before it is tried, and reports how well it can be guessed from what does show.

Two checks for each category. *Bits*: the adaptive expert takes hold of an object, on equal seeds under two hidden
states (three for a lamp); state, effort and every joint of arm and object must be equal bit for bit in every frame up
to and including the one in which the part is held, and so must the cloud and the image of that frame. *Decoders*:
hidden states are dealt out evenly among ``--frames`` seeds, and a linear classifier and nearest neighbours are
cross-validated on what is observed while the part is held; they must stay at chance.

For example: ``python scripts/check_hidden_state.py --category all --seeds 100 --workers 2``. ``--no-hold`` switches off
what hides the state, and the check has to fail. Returns 1 if a category does.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from check_common import Progress, categories_of, in_batches, parser, run_parallel
from numpy.typing import NDArray

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import Phase
from lerobot_adamanip.contract.observation import state_vector
from lerobot_adamanip.evaluation.rates import wilson_interval
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.util.errors import UnreachableError

SEED_OFFSET = 300
FOLDS, NEIGHBOURS, RIDGE = 10, 5, 100.0
Z_SURE = 3.29
"""A decoder that beats chance at this many standard deviations (p = 0.001) has found something."""
TURNS = ({"direction": 1, "turn_range": 0.45}, {"direction": -1, "turn_range": 1.0})
VARIANTS: dict[str, tuple[dict[str, Any], ...]] = {
    **dict.fromkeys(CATEGORIES, TURNS),
    "safe": (
        {"locked": True, "direction": 1, "knob_range": 1.0},
        {"locked": False, "direction": -1, "knob_range": 1.4},
    ),
    "microwave": ({"locked": True}, {"locked": False}),
    "lamp": ({"mode": 0}, {"mode": 1}, {"mode": 2}),
}
"""Hidden states that are as far apart as they can be."""
Frame = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class SeedResult:
    """What became of a seed.

    Attributes:
        seed: of the episode.
        label: index of the variant that the decoders are asked for.
        features: of the frame in which the part is held, under that variant.
        compared: whether the other variants were run, too.
        differences: what differed, frame by frame; none is what there should be.
    """

    seed: int
    label: int
    features: NDArray[np.float32]
    compared: bool
    differences: tuple[str, ...]


def frames_until_held(
    task: Any, seed: int, hidden: dict[str, Any], *, look: bool = True, image: bool = True
) -> list[Frame]:
    """Lets the adaptive expert take hold of the first part; all there is at reset and after each key frame.

    ``cloud`` (M, 3) [m, base frame] and, if one is wanted, ``image`` (H, W, 3) are in the last frame only, and only if
    somebody is to ``look``.
    """
    task.reset(seed=seed, options={"hidden_overrides": hidden, "reconfigure": True})
    expert = make_expert(task.category, "adaptive", task.placement.annotations, generator=np.random.default_rng(seed))
    frames, goal = [_frame(task)], next(expert)
    while goal.phase in (Phase.APPROACH, Phase.GRASP):
        felt = task.execute(goal.action())
        frames.append(_frame(task))
        goal = expert.send(felt)
    if look:
        seen = task.observe(image=image)
        frames[-1].update(cloud=seen.points_in_base, **({"image": seen.images["front"]} if image else {}))
    return frames


def _frame(task: Any) -> Frame:
    arm, robot, target = task.arm_state(), task.agent.robot._objs[0], task._objects.articulation._objs[0]
    return {
        "state": state_vector(task.feedback, arm.qpos, arm.qvel),
        "effort": np.asarray(task.effort, np.float32),
        "outcome": np.array(-1 if task.feedback.outcome is None else int(task.feedback.outcome)),
        "arm positions": np.array(robot.get_qpos()),
        "arm velocities": np.array(robot.get_qvel()),
        "object positions": np.array(target.get_qpos()),
        "object velocities": np.array(target.get_qvel()),
    }


def differences(first: list[Frame], second: list[Frame]) -> tuple[str, ...]:
    """Returns what is not equal bit for bit, in words."""
    found = [] if len(first) == len(second) else [f"{len(first)} frames, {len(second)} frames"]
    for number, (one, other) in enumerate(zip(first, second, strict=False)):
        for name, value in one.items():
            if name not in other or value.shape != other[name].shape:
                found.append(f"frame {number}: {name} of another shape")
            elif value.tobytes() != other[name].tobytes():
                far = np.abs(value.astype(np.float64) - other[name].astype(np.float64)).max()
                found.append(f"frame {number}: {name} by up to {far:.2g}")
    return tuple(found)


def features_of(frame: Frame) -> NDArray[np.float32]:
    """State, effort, moments of the cloud, and a thumbnail of 8 x 8."""
    image = frame["image"]
    edge = 8 * (image.shape[0] // 8)
    thumbnail = image[:edge, :edge].reshape(8, edge // 8, 8, edge // 8, 3).mean(axis=(1, 3))
    cloud = frame["cloud"]
    parts = (frame["state"], frame["effort"], cloud.mean(0), cloud.std(0), thumbnail.ravel())
    return np.concatenate([np.ravel(part) for part in parts]).astype(np.float32)


def check_seed(task: Any, seed: int, label: int, *, compare: bool) -> SeedResult:
    """Runs one seed under its own variant, and under the others to compare."""
    variants = VARIANTS[task.category]
    own = frames_until_held(task, seed, variants[label])
    found: list[str] = []
    for other in range(len(variants)) if compare else ():
        if other != label:
            found += differences(own, frames_until_held(task, seed, variants[other]))
    return SeedResult(seed, label, features_of(own[-1]), compare, tuple(found))


def linear_predictions(
    features: NDArray[np.float64], labels: NDArray[np.int64], queries: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Ridge regression to one-hot classes. (N, D), (N,), (M, D) -> (M,)."""
    inputs, asked = (np.concatenate([each, np.ones((len(each), 1))], axis=1) for each in (features, queries))
    targets = np.eye(int(labels.max()) + 1)[labels]
    weights = np.linalg.solve(inputs.T @ inputs + RIDGE * np.eye(inputs.shape[1]), inputs.T @ targets)
    return np.asarray((asked @ weights).argmax(1))


def neighbour_predictions(
    features: NDArray[np.float64], labels: NDArray[np.int64], queries: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Vote of the nearest neighbours. (N, D), (N,), (M, D) -> (M,)."""
    distances = np.linalg.norm(queries[:, None] - features[None], axis=-1)
    nearest = labels[np.argsort(distances, axis=1)[:, :NEIGHBOURS]]
    votes = (nearest[..., None] == np.arange(int(labels.max()) + 1)).sum(axis=1)
    return np.asarray(votes.argmax(1))


DECODERS = {"linear": linear_predictions, "nearest neighbours": neighbour_predictions}


def decode(features: NDArray[np.float64], labels: NDArray[np.int64]) -> dict[str, dict[str, Any]]:
    """Cross-validates each decoder: accuracy, its 95 % Wilson interval, chance, and whether it beats chance."""
    order = np.random.default_rng(0).permutation(len(labels))
    folds, chance = np.array_split(order, FOLDS), float(np.bincount(labels).max() / len(labels))
    report = {}
    for name, predict in DECODERS.items():
        right = 0
        for fold in folds:
            rest = np.setdiff1d(order, fold)
            mean, scale = features[rest].mean(0), features[rest].std(0)
            scale[scale == 0.0] = 1.0
            known, asked = ((features[rows] - mean) / scale for rows in (rest, fold))
            right += int((predict(known, labels[rest], asked) == labels[fold]).sum())
        low, high = wilson_interval(right, len(labels))
        report[name] = {
            "frames": len(labels),
            "accuracy": round(right / len(labels), 4),
            "interval_95": [round(low, 4), round(high, 4)],
            "chance": round(chance, 4),
            "beats_chance": wilson_interval(right, len(labels), Z_SURE)[0] > chance,
        }
    return report


_tasks: dict[tuple[str, bool], Any] = {}


def task_of(category: str, hold: bool) -> Any:
    """Returns this process's simulator of a category; one at a time."""
    if (category, hold) not in _tasks:
        from lerobot_env_adamanip.simulator import make_task

        warnings.filterwarnings("ignore")
        while _tasks:
            _tasks.popitem()[1].close()
        _tasks[category, hold] = task = make_task(category)
        task.holds_the_untried = hold
    return _tasks[category, hold]


def check_batch(category: str, work: list[tuple[int, int, bool]], hold: bool) -> list[SeedResult | None]:
    """Runs (seed, label, compare) one after the other; None where an object cannot be placed."""
    results: list[SeedResult | None] = []
    for seed, label, compare in work:
        try:
            results.append(check_seed(task_of(category, hold), seed, label, compare=compare))
        except UnreachableError:
            results.append(None)
    return results


def plan(category: str, seeds: int, frames: int) -> list[tuple[int, int, bool]]:
    """Returns seeds, labels dealt out evenly and at random, and which seeds are run under every variant."""
    count = max(seeds, frames)
    labels = np.random.default_rng(len(category)).permutation(np.arange(count) % len(VARIANTS[category]))
    return [(SEED_OFFSET + k, int(labels[k]), k < seeds) for k in range(count)]


def summary(category: str, results: list[SeedResult], options: argparse.Namespace) -> dict[str, Any]:
    """Returns the report of a category, JSON-able."""
    results = sorted(results, key=lambda result: result.seed)
    compared = [result for result in results if result.compared]
    differing = {str(result.seed): list(result.differences) for result in compared if result.differences}
    enough = len(results) >= 2 * FOLDS
    features, labels = np.stack([r.features for r in results]).astype(np.float64), np.array([r.label for r in results])
    decoders = decode(features, labels) if enough else {}
    return {
        "category": category,
        "hold": not options.no_hold,
        "seeds": len(compared),
        "variants": len(VARIANTS[category]),
        "differing_seeds": len(differing),
        "differences": differing,
        "decoders": decoders,
        "passed": not differing and not any(each["beats_chance"] for each in decoders.values()),
    }


def check(category: str, options: argparse.Namespace) -> dict[str, Any]:
    """Checks a category."""
    work = plan(category, options.seeds, options.frames)
    batches = [(category, part, not options.no_hold) for part in in_batches(work)]
    found = run_parallel(check_batch, batches, options.workers, Progress(0, len(work)))
    return summary(category, [each for part in found for each in part if each is not None], options)


def lines(report: dict[str, Any]) -> Iterator[str]:
    """The report of a category in words."""
    yield (
        f"{report['category']:16} {report['seeds']:4} seeds under {report['variants']} hidden states: "
        f"{report['differing_seeds']} differ before anything is tried"
    )
    for seed, found in list(report["differences"].items())[:5]:
        yield f"  seed {seed}: {'; '.join(found[:4])}"
    for name, each in report["decoders"].items():
        low, high = each["interval_95"]
        yield f"  {name:18} {each['accuracy']:.3f} [{low:.3f}, {high:.3f}], chance {each['chance']:.3f}"


def main() -> int:
    """Parses, runs, prints. Returns 0 if nothing shows."""
    made = parser(__doc__, seeds=100, first_seed=SEED_OFFSET)
    made.add_argument("--frames", type=int, default=400, help="held frames for the decoders; 0 for those of --seeds")
    made.add_argument("--no-hold", action="store_true", help="joints move from reset on; the check has to fail")
    options = made.parse_args()
    reports = [check(name, options) for name in categories_of(options)]
    text = json.dumps(reports) if options.json else "\n".join(line for each in reports for line in lines(each))
    sys.stdout.write(text + "\n")
    return 0 if all(report["passed"] for report in reports) else 1


if __name__ == "__main__":
    sys.exit(main())
