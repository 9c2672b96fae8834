"""Runs the scripted experts without rendering and reports their success rates.

A cell is a set of mechanism rules, a category, an object split and an expert. Each cell has ``--episodes`` episodes,
and both experts get the same ones. All attempts count: a scene without a placed object is also a failure. Success is
the task's success; the expert continues to its own end. For example:

    python scripts/check_experts.py --category all --episodes 20 --first-seed 9000000 --workers 2
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from check_common import count, header, in_batches, list_of, run_parallel

from lerobot_adamanip.catalog import category_of, object_split, parse_object_selection
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.evaluation.metrics import Metrics
from lerobot_adamanip.evaluation.rates import rate, success_summary, wilson_interval
from lerobot_adamanip.evaluation.record import hidden_names
from lerobot_adamanip.evaluation.results import ResultRow, check_command, make_result, write_result
from lerobot_adamanip.mechanisms import MECHANISM_RULES
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError, UnreachableError

FIRST_SEED = 5_000_000
"""Default first seed, outside the seeds of demonstrations and evaluations. Experts were tuned on these scenes."""
SPLITS, EXPERTS = ("seen", "unseen", "novel"), ("adaptive", "static")


@dataclass(frozen=True)
class Episode:
    """An episode and, after its run, its result. ``key_frames``: until success; ``placed``: whether a scene exists."""

    mechanism_rules: str
    category: str
    kind: str
    split: str
    object_id: str
    seed: int
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
        return self._task.feedback

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Drives the arm to one key frame. The episode continues after success."""
        self._task.execute(action)
        self._count += 1
        if not self.opened_after and self._task.succeeded():
            self.opened_after = self._count
        return {}, 0.0, False, False, {"is_success": bool(self.opened_after)}


def run_batch(episodes: list[Episode]) -> list[Episode]:
    """Runs episodes of one set of mechanism rules and category sequentially in one simulator."""
    warnings.filterwarnings("ignore")
    from lerobot_env_adamanip.simulator import make_task

    task = make_task(episodes[0].category, mechanism_rules=episodes[0].mechanism_rules)
    try:
        return [_run(task, episode) for episode in episodes]
    finally:
        task.close()


def _run(task: Any, episode: Episode) -> Episode:
    import numpy as np

    from lerobot_adamanip.contract.schema import MAX_KEY_FRAMES
    from lerobot_adamanip.episode.rollout import rollout
    from lerobot_adamanip.experts import make_expert

    try:
        task.reset(seed=episode.seed, options={"object_id": episode.object_id, "reconfigure": True})
    except UnreachableError as error:
        return replace(episode, placed=False, reason=str(error).splitlines()[0])
    hidden, env = task.hidden_state(), BlindEnvironment(task, MAX_KEY_FRAMES)
    expert = make_expert(
        episode.category,
        episode.kind,
        task.placement.annotations,
        generator=np.random.default_rng(episode.seed),
        hidden=hidden if episode.kind == "static" else None,
        mechanism_rules=episode.mechanism_rules,
        feedback=task.feedback,
    )
    result = rollout(env, {}, expert)  # type: ignore[arg-type]
    where = {name: round(position, 3) for name, position in task.joint_positions().items()}
    reason = "" if result.success else f"{result.reason}; joints {where}"
    return replace(episode, success=result.success, key_frames=env.opened_after, hidden=hidden, reason=reason)


Run = Callable[[list[Episode], int], list[Episode]]


def plan(options: argparse.Namespace) -> list[Episode]:
    """Returns all requested episodes. Raises `ConfigurationError` if ``--objects`` belong to other categories."""
    names = tuple(CATEGORIES) if options.category == ALL else (options.category,)
    found = []
    for rules, (split, category, object_ids) in itertools.product(options.mechanism_rules, _selected(names, options)):
        for number in range(options.episodes):
            # Spread over the objects. Small categories repeat objects with other seeds.
            chosen = object_ids[number * len(object_ids) // options.episodes % len(object_ids)]
            seed = options.first_seed + 10_000 * (SPLITS.index(split) if split in SPLITS else len(SPLITS)) + number
            found += [Episode(rules, category, kind, split, chosen, seed) for kind in options.experts]
    return found


def _selected(names: Sequence[str], options: argparse.Namespace) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yields split, category and object ids of each cell. Single ids belong to the category in their name."""
    if not options.objects:
        for category in names:
            for split in options.splits:
                yield split, category, parse_object_selection(category, split)
        return
    plain = ":" in options.objects or options.objects in SPLITS
    ids = [each.strip() for each in options.objects.split(",")]
    for category in names:
        mine = options.objects if plain else ",".join(each for each in ids if category_of(each) == category)
        if mine:
            yield "chosen", category, parse_object_selection(category, mine)
    strangers = [] if plain else [each for each in ids if category_of(each) not in names]
    if strangers:
        raise ConfigurationError(
            "Objects of another category.",
            got=", ".join(strangers),
            allowed=f"ids of {', '.join(names)}",
            hint=f"--category {category_of(strangers[0])} --objects {strangers[0]}",
        )


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
    return [
        {"category": key[0], "expert": key[1], "mechanism_rules": key[2], "split": key[3], **_counts(chosen)}
        for key, chosen in sorted(cells.items(), key=lambda item: (tuple(CATEGORIES).index(item[0][0]), item[0][1:]))
    ]


def _counts(episodes: list[Episode]) -> dict[str, Any]:
    kept = [episode for episode in episodes if episode.success]
    frames = sum(episode.key_frames for episode in kept) / len(kept) if kept else None
    return {
        "attempted": len(episodes),
        "placed": sum(episode.placed for episode in episodes),
        "kept": len(kept),
        **success_summary(rate(len(kept), len(episodes))),
        "wilson_95": list(wilson_interval(len(kept), len(episodes))),
        "mean_key_frames": frames,
    }


def below(rows: list[dict[str, Any]], threshold: float, mean: float) -> list[str]:
    """Returns texts for all values below a threshold: category and expert, and the mean over categories."""
    shares = {(row["category"], row["expert"]): row["kept"] / row["attempted"] for row in rows if row["split"] == "all"}
    low = [f"{category} {kind}: {share:.3f}" for (category, kind), share in shares.items() if share < threshold]
    for wanted in dict.fromkeys(kind for _, kind in shares):
        some = [share for (_, kind), share in shares.items() if kind == wanted]
        if sum(some) / len(some) < mean:
            low.append(f"mean of {wanted}: {sum(some) / len(some):.4f}")
    return low


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
        objects = split if split in SPLITS else object_split(chosen[0].object_id) or "external"
        rows.append(ResultRow(kind, rules, category, objects, metrics))
    return rows


def command_line() -> argparse.ArgumentParser:
    """Returns the command line."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--category", choices=(*CATEGORIES, ALL), default="safe", help="category, or all (%(default)s)")
    made.add_argument("--splits", type=list_of(SPLITS), default=("seen", "unseen"), help="splits separated by commas")
    made.add_argument("--objects", help="ids separated by commas, or FIRST:END, instead of splits")
    made.add_argument("--experts", type=list_of(EXPERTS), default=EXPERTS, help="experts separated by commas")
    rules = tuple(MECHANISM_RULES)
    made.add_argument("--mechanism-rules", type=list_of(rules), default=("paper",), help="rules separated by commas")
    made.add_argument("--episodes", type=count, default=20, help="episodes per cell (%(default)s)")
    made.add_argument("--first-seed", type=count, default=FIRST_SEED, help="seed of the first episode (%(default)s)")
    made.add_argument("--workers", type=count, default=1, help="processes; each needs about 2 GB (%(default)s)")
    made.add_argument("--threshold", type=float, default=0.97, help="minimum success rate per category and expert")
    made.add_argument("--mean", type=float, default=0.99, help="minimum mean success rate over the categories")
    made.add_argument("--result", type=Path, help="result file to write, for scripts/make_results.py")
    made.add_argument("--json", action="store_true", help="print JSON instead of the table")
    return made


def run_all(episodes: list[Episode], workers: int) -> list[Episode]:
    """Runs episodes in processes. Episodes of one set of mechanism rules and category share a simulator."""
    groups = grouped(episodes, "mechanism_rules", "category").values()
    batches = [(part,) for group in groups for part in in_batches(group)]
    found = run_parallel(run_batch, batches, workers, len(episodes))
    return [episode for _, part in found for episode in part]


def main(arguments: Sequence[str] | None = None, run: Run = run_all) -> int:
    """Parses, runs, prints. Returns 0 if all success rates reach the thresholds, 1 if not, 2 for invalid options."""
    options, said, begin = command_line().parse_args(arguments), header(), time.monotonic()
    try:
        if options.result is not None:
            check_command(said["command"])
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
            command=said["command"],
            seeds=[episode.seed for episode in finished],
            scenes=None,
            seconds=time.monotonic() - begin,
        )
        write_result(options.result, result)
    rows, failures = summarise(finished), [episode for episode in finished if not episode.success]
    low = below(rows, options.threshold, options.mean)
    seeds = [min(e.seed for e in finished), max(e.seed for e in finished)]
    content = {**said, "seeds": seeds, "results": rows, "failures": [asdict(e) for e in failures], "below": low}
    text = json.dumps(content) if options.json else table(rows, failures) + "".join(f"\nbelow: {each}" for each in low)
    sys.stdout.write(text + "\n")
    return 1 if low else 0


if __name__ == "__main__":
    sys.exit(main())
