"""Runs the scripted experts over every object of a category, without rendering, and prints how often they succeed.

The adaptive expert never sees the hidden state; the static one does. Success is the task's own. For example:
``python scripts/check_experts.py --category all --seeds 2 --workers 2 --json``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from typing import Any

from lerobot_adamanip.catalog import parse_object_selection
from lerobot_adamanip.categories import ALL, CATEGORIES
from lerobot_adamanip.evaluation.metrics import wilson_interval

FIRST_SEED = 5_000_000
"""Away from the seeds of demonstrations and evaluations; experts were tuned on these."""


@dataclass(frozen=True)
class Episode:
    """One to run, and afterwards how it went."""

    category: str
    kind: str
    split: str
    object_id: str
    seed: int
    success: bool = False
    key_frames: int = 0
    hidden: dict[str, Any] | None = None
    reason: str = ""


def run(episodes: list[Episode]) -> list[Episode]:
    """Runs episodes one after the other in one simulator."""
    return list(_run_each(episodes))


def _run_each(episodes: list[Episode]) -> Iterator[Episode]:
    warnings.filterwarnings("ignore")
    from lerobot_adamanip.errors import UnreachableError
    from lerobot_env_adamanip.keyframe_env import make_task

    env = make_task(episodes[0].category)
    try:
        for episode in episodes:
            try:
                env.reset(seed=episode.seed, options={"object_id": episode.object_id, "reconfigure": True})
            except UnreachableError as error:
                yield replace(episode, reason=str(error).splitlines()[0])
                continue
            yield _drive(env, episode)
    finally:
        env.close()


def _drive(env: Any, episode: Episode) -> Episode:
    import numpy as np

    from lerobot_adamanip.experts import make_expert
    from lerobot_adamanip.schema import MAX_KEY_FRAMES

    hidden = env.hidden_state()
    expert = make_expert(
        episode.category,
        episode.kind,
        env.placement.annotations,
        generator=np.random.default_rng(episode.seed),
        hidden=hidden if episode.kind == "static" else None,
    )
    success, count, goal = False, 0, next(expert)
    while not success and count < MAX_KEY_FRAMES:
        felt = env.execute(goal.action())
        count, success = count + 1, bool(env.evaluate()["success"][0])
        try:
            goal = expert.send(felt)
        except StopIteration:
            break
    reason = "" if success else f"{felt.outcome.name} in {goal.phase.name}; joints {env.joint_positions()}"
    return replace(episode, success=success, key_frames=count, hidden=hidden, reason=reason)


def plan(category: str, kinds: list[str], seeds: int, unseen: int, first_seed: int = FIRST_SEED) -> list[Episode]:
    """Every object, ``seeds`` times for each expert; both experts meet the same episodes."""
    from lerobot_adamanip.catalog import seen_objects, unseen_objects

    splits = {"seen": seen_objects(category), "unseen": unseen_objects(category, unseen)}
    return [
        Episode(category, kind, split, name, first_seed + 1000 * repeat + number)
        for repeat in range(seeds)
        for split, names in splits.items()
        for number, name in enumerate(names, start=0 if split == "seen" else len(splits["seen"]))
        for kind in kinds
    ]


def run_all(episodes: list[Episode], workers: int, done: Callable[[int], None]) -> list[Episode]:
    """Runs them in ``workers`` processes; ``done`` hears of every batch that has ended."""
    batches = [
        group[start : start + 16]
        for group in (
            [e for e in episodes if e.category == name] for name in dict.fromkeys(e.category for e in episodes)
        )
        for start in range(0, len(group), 16)
    ]
    finished: list[Episode] = []
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for future in as_completed([pool.submit(run, batch) for batch in batches]):
            finished += future.result()
            done(len(finished))
    return finished


def summarise(episodes: list[Episode]) -> list[dict[str, Any]]:
    """A row for each category, expert and split: success, its 95 % Wilson interval, mean key frames of successes."""
    rows = []
    for category, kind, split in dict.fromkeys((e.category, e.kind, e.split) for e in episodes):
        chosen = [e for e in episodes if (e.category, e.kind, e.split) == (category, kind, split)]
        opened = [e for e in chosen if e.success]
        low, high = wilson_interval(len(opened), len(chosen))
        frames = sum(e.key_frames for e in opened) / len(opened) if opened else None
        rows.append(
            {
                "category": category,
                "expert": kind,
                "split": split,
                "episodes": len(chosen),
                "opened": len(opened),
                "wilson_95": [low, high],
                "mean_key_frames": frames,
            }
        )
    return sorted(rows, key=lambda row: (row["category"], row["expert"], row["split"]))


def _table(rows: list[dict[str, Any]], failures: list[Episode]) -> str:
    lines = [f"{'category':16} {'expert':9} {'split':7} {'opened':>9}  95 % interval   key frames"]
    for row in rows:
        low, high = row["wilson_95"]
        frames = "-" if row["mean_key_frames"] is None else f"{row['mean_key_frames']:.1f}"
        count = f"{row['opened']}/{row['episodes']}"
        names = f"{row['category']:16} {row['expert']:9} {row['split']:7}"
        lines.append(f"{names} {count:>9}  {low:.3f} ... {high:.3f}  {frames:>9}")
    lines += [f"failed: {e.kind} {e.object_id} seed {e.seed} {e.hidden} {e.reason}" for e in failures]
    return "\n".join(lines)


def main() -> int:
    """Parses, runs, prints. Returns 0 if every episode succeeded, 1 otherwise."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--category", choices=(*CATEGORIES, ALL), default="safe", help="which kind of object, or all")
    parser.add_argument("--objects", help="ids separated by commas, or FIRST:END, instead of seen and unseen ones")
    parser.add_argument("--seeds", type=int, default=1, help="episodes of each object and expert")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help="of the episodes")
    parser.add_argument("--workers", type=int, default=1, help="processes; each needs about 2 GB")
    parser.add_argument("--unseen", type=int, default=20, help="number of unseen objects")
    parser.add_argument("--experts", nargs="+", choices=("adaptive", "static"), default=["adaptive", "static"])
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    options = parser.parse_args()
    if min(options.seeds, options.workers, options.unseen) < 1:
        parser.error("--seeds, --workers and --unseen are at least 1")
    # One thread each: the workers share the cores already.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    from tqdm import tqdm

    names = CATEGORIES if options.category == ALL else (options.category,)
    episodes = [
        e for name in names for e in plan(name, options.experts, options.seeds, options.unseen, options.first_seed)
    ]
    if options.objects:
        wanted = parse_object_selection(options.category, options.objects)
        episodes = [e for e in episodes if e.object_id in wanted]
    with tqdm(total=len(episodes), unit="episode", disable=None) as bar:
        finished = run_all(episodes, options.workers, lambda count: bar.update(count - bar.n))
    rows, failures = summarise(finished), [e for e in finished if not e.success]
    content = {"results": rows, "failures": [asdict(e) for e in failures]}
    sys.stdout.write((json.dumps(content) if options.json else _table(rows, failures)) + "\n")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
