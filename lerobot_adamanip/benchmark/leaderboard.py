"""Leaderboard: self-reported results of methods on the same test scenes, from result files alone."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

from lerobot_adamanip.benchmark.declaration import OBJECT_SPLITS
from lerobot_adamanip.benchmark.report import opened, within
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.versions import earlier_version
from lerobot_adamanip.evaluation.metrics import METRICS
from lerobot_adamanip.evaluation.results import ResultFile
from lerobot_adamanip.evaluation.text_format import markdown_table, percent_text

TRAINING_SEED, EPISODES, SEEDS = 1000, 100, (700000, 700099)
"""Requirements of an entry: training seed, scenes per category and split of objects, first and last scene seed."""
RULE = f"""The numbers are self-reported: a file cannot prove how it was made. Commands, commits and versions are in it.

An entry is a folder of result files, by pull request to `results/leaderboard/NAME/`. Copy
`lerobot_adamanip/benchmark/default_policy.toml` to `mine.toml`, add a table `[methods.mine]`
([fields](benchmark.md#the-declaration)), and run, in a checkout without changes:

```bash
adamanip benchmark --config mine.toml --scale test --methods mine --seeds {TRAINING_SEED} # 27 cells
mkdir -p results/leaderboard/NAME && cp outputs/benchmark/test/cells/mine-*.json results/leaderboard/NAME
python scripts/make_results.py # writes this page; refuses files that are incomplete or of other scenes
```

Train on demonstrations of seen objects alone, choose your method on validation scenes, and run the test scenes once.
This project's row is of version 0.2.0. Its unseen and novel objects are others, and two choices were made with test
results at hand: its head, and [what counts as a failed try](benchmark.md#the-declaration).
"""


def problems(results: Sequence[ResultFile]) -> Iterator[str]:
    """Yields what an entry lacks: a category or split, the scenes of all entries, or the origin of its numbers."""
    places = [(result.rows[0].category, result.rows[0].objects) for result in results]
    if sorted(places) != sorted(itertools.product(CATEGORIES, OBJECT_SPLITS)):
        yield "not one result of each category and split of objects"
    for result in results:
        name = f"{result.rows[0].category} {result.rows[0].objects}"
        if result.run is None or result.run.seed != TRAINING_SEED:
            yield f"{name}: not a benchmark's result with training seed {TRAINING_SEED}"
        if result.commit is None or result.changed:
            yield f"{name}: made from a commit with changes, or from none"
        episodes = result.rows[0].metrics.success.episodes
        if (result.scenes, result.seeds, episodes) != ("test", SEEDS, EPISODES):
            yield f"{name}: {episodes} {result.scenes} scenes from {result.seeds[0]}, not {EPISODES} from {SEEDS[0]}"
    if len(versions := {str(result.simulation_version) for result in results}) > 1:
        yield f"simulation versions {' and '.join(sorted(versions))}"


def leaderboard_page(entries: Mapping[str, Sequence[ResultFile]]) -> str:
    """Returns the leaderboard as Markdown, best entry first; ``entries``: name of an entry -> its result files."""
    rows = []
    for name, results in entries.items():
        shares = [("seen", within), *((objects, opened) for objects in OBJECT_SPLITS)]
        means = []
        for objects, share in shares:
            rates = [share(result.rows[0].metrics) for result in results if result.rows[0].objects == objects]
            means.append(sum(rate.rate or 0.0 for rate in rates if rate) / len(rates))
        version = ", ".join(sorted({str(result.simulation_version) for result in results}))
        rows.append((means, [name, *map(percent_text, means), version]))
    titles = [
        "entry",
        f"{METRICS['within_best_tries'].title}, seen",
        *(f"opened, {objects}" for objects in OBJECT_SPLITS),
        "simulation version",
    ]
    lines = [line for _, line in sorted(rows, key=lambda row: row[0], reverse=True)]
    table = markdown_table(titles, lines) if lines else "No entry yet."
    earlier = earlier_version(result.simulation_version for results in entries.values() for result in results)
    explanation = f"Means over nine categories, of training seed {TRAINING_SEED}; the first column decides the order."
    return f"# Leaderboard\n\n{table}\n\n{f'{explanation} {earlier}'.strip()}\n\n## To enter\n\n{RULE}"
