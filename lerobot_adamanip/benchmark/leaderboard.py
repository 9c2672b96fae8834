"""Leaderboard: methods evaluated on the same test scenes, from result files alone. Pure functions."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence

from lerobot_adamanip.benchmark.declaration import OBJECT_SPLITS
from lerobot_adamanip.benchmark.plan import COLLECT, CORRECT, FOLDERS, TRAIN, last_checkpoint
from lerobot_adamanip.benchmark.report import least_to_most
from lerobot_adamanip.benchmark.result import OBSERVATION_OPTIONS, CellResult
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.versions import SIMULATION_VERSION, earlier_version, mixed_versions
from lerobot_adamanip.evaluation.metrics import METRICS, Metrics, pool
from lerobot_adamanip.evaluation.rates import Rate
from lerobot_adamanip.evaluation.text_format import counted, markdown_table

EPISODES = 100
"""Number of episodes of each category and split of objects."""
FIRST_SEED = 1000
"""Seed of an entry's first training."""
SCENES = (700000, 700099)
"""First and last seed of the scenes."""
FIXED: Mapping[str, str] = {
    "--env.split": "test",
    "--seed": str(SCENES[0]),
    "--eval.n_episodes": str(EPISODES),
    "--env.poses": "randomized",
    "--env.mechanism_rules": "paper",
}
"""Options of every entry's evaluations."""
_MADE = ("--dataset.root", "--policy.path", "--policy")
"""Options whose values are products of earlier steps."""
RULE = f"""An entry is a folder of result files, by pull request to `results/leaderboard/NAME/`. `adamanip benchmark`
makes them: copy `lerobot_adamanip/benchmark/default_policy.toml` to `mine.toml`, add a table `[methods.mine]`
([fields](benchmark.md#the-declaration)), and run, in a checkout without changes:

```bash
adamanip benchmark --config mine.toml --scale test --methods mine --seeds 1000 # 27 cells
mkdir -p results/leaderboard/NAME && cp outputs/benchmark/test/cells/mine-*.json results/leaderboard/NAME
python scripts/check_entry.py results/leaderboard/NAME
```

For paired differences to `dp3_adaptive`, copy `results/benchmark/test/corrected-*.json` to
`outputs/benchmark/test/cells`, and run the command with `--report`.

- All nine categories on seen, unseen and novel objects, {EPISODES} episodes each, of training seed {FIRST_SEED}; it
  decides the order. Further trainings may be of some categories: seeds {FIRST_SEED + 1}, {FIRST_SEED + 2} and so on.
- `{" ".join(f"{name}={value}" for name, value in FIXED.items())}`, and of the other
  options of the environment only objects, num_points, image_size, observe_images and episode_log.
- A policy that the entry's own steps trained, on demonstrations of seen objects alone; one for all objects.
- A commit without changes, and the present simulation version ({SIMULATION_VERSION}): an entry leaves the page once one
  of a newer version is on it.

Choose your method on validation scenes, and run the test scenes once. In this project's row two choices were made with
test results at hand: [the head, and what counts as a failed try](benchmark.md#the-declaration).
"""


def violations(results: Sequence[CellResult], simulation_version: int) -> Iterator[str]:
    """Yields the broken rules, one sentence each.

    Args:
        results: of one method.
        simulation_version: of the page.
    """
    if not results:
        yield "no result files"
    for result in results:
        yield from (f"{result.cell.name}: {reason}" for reason in _of_cell(result, simulation_version))
    if len(methods := sorted({result.cell.method for result in results})) > 1:
        yield f"several methods: {', '.join(methods)}"
    policies: dict[tuple[str, int], set[tuple[str, ...]]] = {}
    for result in results:
        keys = tuple(result.steps[name].key for name, _ in result.options_of(TRAIN))
        policies.setdefault((result.cell.category, result.cell.seed), set()).add(keys)
    yield from (f"{name}: several policies of seed {seed}" for (name, seed), keys in policies.items() if len(keys) > 1)
    found = _seeds(results)
    for place in itertools.product(CATEGORIES, OBJECT_SPLITS):
        seeds = found.get(place, [])
        if seeds != (first := list(range(FIRST_SEED, FIRST_SEED + max(1, len(seeds))))):
            given, wanted = (", ".join(map(str, each)) or "none" for each in (seeds, first))
            yield f"{' '.join(place)}: training seeds {given}, not {wanted}"


def _seeds(results: Sequence[CellResult]) -> dict[tuple[str, str], list[int]]:
    """Returns the sorted training seeds of each category and split of objects."""
    found: dict[tuple[str, str], list[int]] = {}
    for cell in sorted((each.cell for each in results), key=lambda cell: cell.seed):
        found.setdefault((cell.category, cell.objects), []).append(cell.seed)
    return found


def _of_cell(result: CellResult, simulation_version: int) -> Iterator[str]:
    cell, numbers = result.cell, result.numbers
    options = result.evaluation_options.items()
    given = {name: value for name, value in options if name.startswith("--env") or name in (*FIXED, "--config_path")}
    expected = {**FIXED, "--env.type": f"adamanip_{cell.category}", "--env.objects": cell.objects}
    for name, value in expected.items():
        if given.get(name) != value:
            yield f"{name}={given.get(name)}, not {value}"
    if others := sorted(set(given) - {*expected, *OBSERVATION_OPTIONS}):
        yield f"{', '.join(others)} must keep the default"
    if {len(result.outcomes), len(result.failed_tries), numbers.success.episodes} != {EPISODES}:
        yield f"{counted(numbers.success.episodes, 'episode')}, not {EPISODES}, or without their tries"
    if result.scene_seeds != SCENES:
        yield f"scenes {result.scene_seeds[0]} to {result.scene_seeds[1]}, not {SCENES[0]} to {SCENES[1]}"
    yield from _of_training(result)
    if cell.trials is not None:
        yield "part of a curve over trials"
    if result.changed or result.commit is None:
        yield "made from a commit with changes, or from none"
    if result.simulation_version != simulation_version:
        yield f"measured with simulation version {result.simulation_version}, not {simulation_version}"


def _of_training(result: CellResult) -> Iterator[str]:
    """Yields what is wrong with an entry's data, trainings and evaluated policy."""
    trainings = dict(result.options_of(TRAIN))
    recorded = {each.get("--objects") for kind in (COLLECT, CORRECT) for _, each in result.options_of(kind)}
    if not trainings or recorded != {"seen"}:
        yield "without a training on demonstrations of seen objects"
        return
    if (seeds := {each.get("--seed") for each in trainings.values()}) != {str(result.cell.seed)}:
        yield f"trained with seed {', '.join(map(str, seeds))}, not {result.cell.seed}"
    made = tuple(f"{FOLDERS[name.partition('_')[0]]}/{step.key}" for name, step in result.steps.items())
    trained = [each for kind in (TRAIN, CORRECT) for _, each in result.options_of(kind)]
    used = [each[name] for each in trained for name in _MADE if name in each]
    if others := [each for each in used if not each.startswith(made) or ".." in each]:
        yield f"{', '.join(others)}: not made by the entry's own steps"
    last = last_checkpoint(f"{FOLDERS[TRAIN]}/{result.steps[list(trainings)[-1]].key}")
    if result.evaluation_options.get("--policy.path") != str(last):
        yield "evaluates another policy than that of its last training"


def leaderboard_page(entries: Mapping[str, Sequence[CellResult]]) -> str:
    """Returns the leaderboard as Markdown; ``entries`` are the result files of each, best first on the page."""
    rows = []
    for name, results in entries.items():
        means = _means([each for each in results if each.cell.seed == FIRST_SEED])
        overall = f"{100 * _means(results)[0]:.1f} % ({least_to_most(map(len, _seeds(results).values()))})"
        rows.append((means, [name, *(f"{100 * mean:.1f} %" for mean in means), overall]))
    lines = [line for _, line in sorted(rows, key=operator.itemgetter(0), reverse=True)]
    within = METRICS["within_best_tries"].title
    titles = [
        "entry",
        f"{within}, seen",
        *(f"opened, {each}" for each in OBJECT_SPLITS),
        "the first over all trainings",
    ]
    table = markdown_table(titles, lines) if lines else "No entry yet."
    measured = [result for results in entries.values() for result in results]
    told = [earlier_version({result.simulation_version for result in measured})]
    if mixed := mixed_versions(result.all_versions for result in measured):
        told.append(f"Mind: measured with different versions installed: {mixed}.")
    explanation = (
        f"Means over nine categories, of training seed {FIRST_SEED}; the first column decides the order. The last "
        "one is over all trainings, with their number."
    )
    explanation = " ".join(filter(None, [explanation, *told]))
    return f"# Leaderboard\n\n{table}\n\n{explanation}\n\n## To enter\n\n{RULE}"


def _means(results: Iterable[CellResult]) -> list[float]:
    """Returns the mean within the best strategy's tries on seen objects, and the mean success by split of objects."""
    found: dict[tuple[str, str], list[Metrics]] = {}
    for result in results:
        found.setdefault((result.cell.objects, result.cell.category), []).append(result.numbers)
    pooled = {place: pool(several) for place, several in found.items()}
    shares: list[list[Rate | None]] = [[pooled["seen", category].within_best_tries for category in CATEGORIES]]
    shares += [[pooled[objects, category].success for category in CATEGORIES] for objects in OBJECT_SPLITS]
    return [sum(each.rate or 0.0 for each in rates if each) / len(CATEGORIES) for rates in shares]
