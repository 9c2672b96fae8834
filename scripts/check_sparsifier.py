"""Finds key frames in dense simulated episodes, where they are known: precision and recall of each category.

    python scripts/check_sparsifier.py --category all --objects 0:2 --episodes 2 --json

Experts work through episodes as they do for `adamanip collect`; every control tick is kept, key frames are looked for
in the ticks alone, and compared with those that were driven. Key frames that leave the arm and its fingers where they
are (a pull that is repeated against the same stop) are counted apart: in a recording they are one stay.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from check_common import Progress, count, header

from lerobot_adamanip.catalog import select_objects
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.datasets.collection_spec import CollectionSpec
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.recordings.keyframe_choice import choose_key_frames
from lerobot_adamanip.recordings.keyframe_score import Score, score
from lerobot_env_adamanip.dense import FPS, TickWatch, successful_episode
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

ENOUGH = 0.95
"""Of precision and of recall."""


def options() -> argparse.Namespace:
    """Returns what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--category", default=ALL, help="one, several with commas between, or all")
    parser.add_argument("--objects", default="0:1")
    parser.add_argument("--episodes", type=count, default=1, help="of each object")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--max-attempts", type=count, default=5)
    parser.add_argument("--out", type=Path, help="write the result here as well")
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()


def measured(category: str, chosen: argparse.Namespace, progress: Progress) -> tuple[Score, int]:
    """Returns the score over a category's episodes, and how many these were."""
    environment = EnvironmentOptions(category=category, objects=chosen.objects, observe_images=False)
    spec = CollectionSpec(
        environment=environment,
        objects=tuple(select_objects(category, chosen.objects, None)),
        episodes_per_object=chosen.episodes,
        seed=chosen.seed,
        late_starts=0.0,
    )
    total, items = Score(), spec.items()
    env = KeyframeEnv(options=spec.environment_of(category))
    try:
        watch = TickWatch(env)
        for item in items:
            episode, known = successful_episode(watch, spec, make_expert, item, chosen.max_attempts)
            total += score(episode, choose_key_frames(episode, FPS), known.ends, FPS)
            progress.tell(1)
    finally:
        env.close()
    return total, len(items)


def told(found: Score, episodes: int) -> dict[str, Any]:
    """Returns a JSON-able row."""
    return {**vars(found), "episodes": episodes, "precision": found.precision, "recall": found.recall}


def main() -> int:
    """Measures; 0 if all categories have enough of both."""
    chosen = options()
    categories = tuple(CATEGORIES) if chosen.category == ALL else tuple(chosen.category.split(","))
    objects = sum(len(select_objects(category, chosen.objects, None)) for category in categories)
    progress = Progress(0, objects * chosen.episodes)
    rows: dict[str, dict[str, Any]] = {}
    for category in categories:
        found, episodes = measured(category, chosen, progress)
        rows[category] = told(found, episodes)
        if not chosen.json:
            row = rows[category]
            line = f"{category}: precision {row['precision']:.3f}, recall {row['recall']:.3f} of {row['known']}"
            sys.stdout.write(line + "\n")
    enough = all(min(row["precision"], row["recall"]) >= ENOUGH for row in rows.values())
    result = {**header(), "categories": rows, "enough": ENOUGH, "passed": enough}
    if chosen.out is not None:
        chosen.out.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    if chosen.json:
        sys.stdout.write(json.dumps(result) + "\n")
    return 0 if enough else 1


if __name__ == "__main__":
    sys.exit(main())
