"""Runs the scripted experts without rendering and reports their success rates.

A cell is a set of mechanism rules, a category, an object split and an expert. Each cell has ``--episodes`` episodes;
with ``--objects``, the splits of a category's objects share them. Both experts get the same episodes. All attempts
count: a scene without a placed object is also a failure. Success is the task's success; the expert continues to its own
end. For example:

    python scripts/check_experts.py --category all --episodes 20 --first-seed 9000000 --workers 2
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from check_common import count, header, in_batches, list_of, run_parallel

from lerobot_adamanip.catalog import category_of, object_split, parse_object_selection
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.contract.control import ACTION_NAMES, KEYFRAME
from lerobot_adamanip.contract.schema import MAX_KEY_FRAMES
from lerobot_adamanip.episode.dense import dense_rollout
from lerobot_adamanip.episode.rollout import rollout
from lerobot_adamanip.evaluation.metrics import Metrics
from lerobot_adamanip.evaluation.rates import rate, success_summary, wilson_interval
from lerobot_adamanip.evaluation.record import hidden_names
from lerobot_adamanip.evaluation.results import ResultRow, check_command, make_result, write_result
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.mechanisms import MECHANISM_RULES
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError, UnreachableError

FIRST_SEED = 5_000_000
"""Default first seed, outside the seeds of demonstrations and evaluations. Experts were tuned on these scenes."""
SPLITS, EXPERTS = ("seen", "unseen", "novel"), ("adaptive", "static")


@dataclass(frozen=True)
class Episode:
    """An episode and, after its run, its result.

    ``action``: of dense control, or ``keyframe``. ``key_frames``: key frames or dense steps until success; ``placed``:
    whether a scene exists.
    """

    mechanism_rules: str
    category: str
    kind: str
    split: str
    object_id: str
    seed: int
    action: str = KEYFRAME
    placed: bool = True
    success: bool = False
    key_frames: int = 0
    hidden: dict[str, Any] | None = None
    reason: str = ""


class BlindEnvironment:
    """Minimal `KeyframeEnvironment` for `rollout`, without rendering and clouds."""

    def __init__(self, task: Any, max_key_frames: int) -> None:
        self._task, self.max_key_frames = task, max_key_frames
        self.opened_after = 0
        """Number of key frames until success; 0 without success."""
        self._count = 0

    @property
    def feedback(self) -> Any:
        """Feedback of the latest key frame."""
        return self._task.driver.feedback

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Drives the arm to one key frame. The episode continues after success."""
        self._task.execute(action)
        self._count += 1
        if not self.opened_after and self._task.simulation.succeeded():
            self.opened_after = self._count
        return {}, 0.0, False, False, {"is_success": bool(self.opened_after)}


def run_batch(episodes: list[Episode]) -> list[Episode]:
    """Runs episodes of one set of mechanism rules and category sequentially in one simulator."""
    from lerobot_env_adamanip.simulator import make_task

    warnings.filterwarnings("ignore")
    if episodes[0].action != KEYFRAME:
        return run_dense_batch(episodes)
    with contextlib.closing(make_task(episodes[0].category, mechanism_rules=episodes[0].mechanism_rules)) as task:
        return [_run(task, episode) for episode in episodes]


def _run(task: Any, episode: Episode) -> Episode:
    try:
        task.reset(seed=episode.seed, options={"object_id": episode.object_id, "reconfigure": True})
    except UnreachableError as error:
        return replace(episode, placed=False, reason=str(error).splitlines()[0])
    hidden, env = task.simulation.hidden_state(), BlindEnvironment(task, MAX_KEY_FRAMES)
    expert = make_expert(
        episode.category,
        episode.kind,
        task.placement.annotations,
        generator=np.random.default_rng(episode.seed),
        hidden=hidden if episode.kind == "static" else None,
        mechanism_rules=episode.mechanism_rules,
        feedback=task.driver.feedback,
    )
    result = rollout(env, {}, expert)  # type: ignore[arg-type]
    joints = {name: round(position, 3) for name, position in task.simulation.joint_positions().items()}
    reason = "" if result.success else f"{result.reason}; joints {joints}"
    return replace(episode, success=result.success, key_frames=env.opened_after, hidden=hidden, reason=reason)


def run_dense_batch(episodes: list[Episode]) -> list[Episode]:
    """Runs episodes of one set of mechanism rules, category and kind of action at control rate."""
    from lerobot_env_adamanip.dense_env import DenseEnv

    first, finished = episodes[0], []
    rules, action = first.mechanism_rules, first.action
    with contextlib.closing(
        DenseEnv(first.category, mechanism_rules=rules, action=action, observe_images=False)
    ) as env:
        for episode in episodes:
            try:
                env.reset(seed=episode.seed, options={"object_id": episode.object_id})
            except UnreachableError as error:
                finished.append(replace(episode, placed=False, reason=str(error).splitlines()[0]))
                continue
            hidden = env.hidden_state()
            expert = make_expert(
                episode.category,
                episode.kind,
                env.annotations,
                generator=np.random.default_rng(episode.seed),
                hidden=hidden if episode.kind == "static" else None,
                mechanism_rules=rules,
            )
            result = dense_rollout(env, {}, expert)
            steps = env.episode_record()["key_frames"]
            reason = "" if result.success else result.reason
            finished.append(replace(episode, success=result.success, key_frames=steps, hidden=hidden, reason=reason))
    return finished


Run = Callable[[list[Episode], int], list[Episode]]


def plan(options: argparse.Namespace) -> list[Episode]:
    """Returns all requested episodes. Raises `ConfigurationError` if ``--objects`` belong to other categories."""
    categories = tuple(CATEGORIES) if options.category == ALL else (options.category,)
    cells: list[tuple[str, str, str]] = [(name, split, split) for name in categories for split in options.splits]
    if options.objects:
        ids = [name.strip() for name in options.objects.split(",")]
        is_selection = ":" in options.objects or options.objects in SPLITS
        strangers = [] if is_selection else [name for name in ids if category_of(name) not in categories]
        if strangers:
            raise ConfigurationError(
                "Objects of another category.",
                got=", ".join(strangers),
                allowed=f"ids of {', '.join(categories)}",
                hint=f"--category {category_of(strangers[0])} --objects {strangers[0]}",
            )
        own = {name: ",".join(each for each in ids if is_selection or category_of(each) == name) for name in categories}
        cells = [(name, "chosen", selection) for name, selection in own.items() if selection]
    episodes = []
    for rules, (category, split, selection) in itertools.product(options.mechanism_rules, cells):
        objects = parse_object_selection(category, selection)
        first_seed = options.first_seed + 10_000 * (SPLITS.index(split) if split in SPLITS else len(SPLITS))
        for number in range(options.episodes):
            # Spread over the objects. Small categories repeat objects with other seeds.
            chosen = objects[number * len(objects) // options.episodes % len(objects)]
            place = (object_split(chosen) or "external", chosen, first_seed + number, options.action)
            episodes += [Episode(rules, category, kind, *place) for kind in options.experts]
    return episodes


def grouped(episodes: list[Episode], *names: str) -> dict[tuple[str, ...], list[Episode]]:
    """Groups episodes by the values of fields."""
    groups: dict[tuple[str, ...], list[Episode]] = {}
    for episode in episodes:
        groups.setdefault(tuple(getattr(episode, name) for name in names), []).append(episode)
    return groups


def summarise(episodes: list[Episode]) -> list[dict[str, Any]]:
    """Returns a row per cell, and a row ``all`` per category and expert over all splits and mechanism rules."""
    cells = grouped(episodes, "category", "kind", "mechanism_rules", "split")
    cells |= {(*key, "all", "all"): chosen for key, chosen in grouped(episodes, "category", "kind").items()}
    rows = []
    for key, chosen in sorted(cells.items(), key=lambda item: (tuple(CATEGORIES).index(item[0][0]), item[0][1:])):
        frames = [episode.key_frames for episode in chosen if episode.success]
        rows.append(
            {
                **dict(zip(("category", "expert", "mechanism_rules", "split"), key, strict=True)),
                "attempted": len(chosen),
                "placed": sum(episode.placed for episode in chosen),
                "kept": len(frames),
                **success_summary(rate(len(frames), len(chosen))),
                "wilson_95": list(wilson_interval(len(frames), len(chosen))),
                "mean_key_frames": sum(frames) / len(frames) if frames else None,
            }
        )
    return rows


def below(rows: list[dict[str, Any]], threshold: float, mean: float) -> list[str]:
    """Returns texts for all values below a threshold: each cell, and the mean of its like over the categories."""
    low, means = list[str](), dict[str, list[float]]()
    for row in (row for row in rows if row["split"] != "all"):
        share, cell = row["kept"] / row["attempted"], " ".join((row["expert"], row["mechanism_rules"], row["split"]))
        means.setdefault(cell, []).append(share)
        if share < threshold:
            low.append(f"{row['category']} {cell}: {share:.3f}")
    averages = {cell: sum(shares) / len(shares) for cell, shares in means.items()}
    return low + [f"mean of {cell}: {average:.4f}" for cell, average in averages.items() if average < mean]


def table(rows: list[dict[str, Any]], failures: list[Episode]) -> str:
    """Returns rows and failures as text."""
    lines = [f"{'category':16} {'expert':9} {'rules':9} {'split':7} {'kept':>9}  95 % interval   key frames"]
    for row in rows:
        low, high = row["wilson_95"]
        frames = "-" if row["mean_key_frames"] is None else f"{row['mean_key_frames']:.1f}"
        names = f"{row['category']:16} {row['expert']:9} {row['mechanism_rules']:9} {row['split']:7}"
        lines.append(f"{names} {row['kept']:>4}/{row['attempted']:<4}  {low:.3f} ... {high:.3f}  {frames:>9}")
    for e in failures:
        lines.append(f"failed: {e.mechanism_rules} {e.kind} {e.object_id} seed {e.seed} {e.hidden} {e.reason}")
    return "\n".join(lines)


def result_rows(episodes: list[Episode]) -> list[ResultRow]:
    """Returns a result-file row per cell."""
    rows = []
    for (kind, rules, category, split), chosen in grouped(
        episodes, "kind", "mechanism_rules", "category", "split"
    ).items():
        hidden: dict[str, list[bool]] = {}
        for e in chosen:
            discrete = {name: value for name, value in (e.hidden or {}).items() if not isinstance(value, float)}
            for name in hidden_names(category, discrete, {}):
                hidden.setdefault(name, []).append(e.success)
        metrics = Metrics(
            success=rate(sum(e.success for e in chosen), len(chosen)),
            hidden={name: rate(sum(each), len(each)) for name, each in sorted(hidden.items())},
            key_frames=dict(sorted(Counter(e.key_frames for e in chosen if e.success).items())),
        )
        rows.append(ResultRow(kind, rules, category, split, metrics))
    return rows


def run_all(episodes: list[Episode], workers: int) -> list[Episode]:
    """Runs episodes in processes. Episodes of one set of mechanism rules and category share a simulator."""
    groups = grouped(episodes, "mechanism_rules", "category").values()
    batches = [(part,) for group in groups for part in in_batches(group)]
    results = run_parallel(run_batch, batches, workers, len(episodes))
    return [episode for _, part in results for episode in part]


def main(arguments: Sequence[str] | None = None, run: Run = run_all) -> int:
    """Parses, runs, prints. Returns 0 if all success rates reach the thresholds, 1 if not, 2 for invalid options."""
    line = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    line.add_argument("--category", choices=(*CATEGORIES, ALL), default="safe", help="category, or all (%(default)s)")
    line.add_argument("--splits", type=list_of(SPLITS), default=("seen", "unseen"), help="splits separated by commas")
    line.add_argument("--objects", help="ids separated by commas, or FIRST:END, instead of splits")
    line.add_argument("--experts", type=list_of(EXPERTS), default=EXPERTS, help="experts separated by commas")
    rules = tuple(MECHANISM_RULES)
    line.add_argument("--mechanism-rules", type=list_of(rules), default=("paper",), help="rules separated by commas")
    line.add_argument(
        "--action", choices=(KEYFRAME, *ACTION_NAMES), default=KEYFRAME, help="keyframe, or a dense action"
    )
    line.add_argument("--episodes", type=count, default=20, help="episodes per cell (%(default)s)")
    line.add_argument("--first-seed", type=count, default=FIRST_SEED, help="seed of the first episode (%(default)s)")
    line.add_argument("--workers", type=count, default=1, help="processes; each needs about 2 GB (%(default)s)")
    line.add_argument("--threshold", type=float, default=0.97, help="minimum success rate of each cell")
    line.add_argument("--mean", type=float, default=0.99, help="minimum of a cell's mean over the categories")
    line.add_argument("--result", type=Path, help="result file to write, for scripts/make_results.py")
    line.add_argument("--json", action="store_true", help="print JSON instead of the table")
    options, metadata, begin = line.parse_args(arguments), header(), time.monotonic()
    try:
        if options.result is not None:
            check_command(metadata["command"])
        finished = run(plan(options), options.workers)
    except AdaManipError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    if options.result is not None:
        rules = ", ".join(dict.fromkeys(episode.mechanism_rules for episode in finished))
        result = make_result(
            result_rows(finished),
            kind="expert",
            title=f"scripted experts, mechanism rules {rules}",
            command=metadata["command"],
            seeds=[episode.seed for episode in finished],
            scenes=None,
            seconds=time.monotonic() - begin,
        )
        write_result(options.result, result)
    rows, failures = summarise(finished), [episode for episode in finished if not episode.success]
    low = below(rows, options.threshold, options.mean)
    seeds = [min(e.seed for e in finished), max(e.seed for e in finished)]
    content = {**metadata, "seeds": seeds, "results": rows, "failures": [asdict(e) for e in failures], "below": low}
    text = (
        json.dumps(content) if options.json else table(rows, failures) + "".join(f"\nbelow: {value}" for value in low)
    )
    sys.stdout.write(text + "\n")
    return 1 if low else 0


if __name__ == "__main__":
    sys.exit(main())
