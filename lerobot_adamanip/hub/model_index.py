"""Results on a card: a table and the Hub's `model-index`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.evaluation.metrics import METRICS
from lerobot_adamanip.evaluation.rates import success_summary
from lerobot_adamanip.evaluation.results import ResultFile, ResultRow
from lerobot_adamanip.evaluation.text_format import markdown_table, words

if TYPE_CHECKING:
    from huggingface_hub import EvalResult

_SHOWN = ("success", "key_frames", "failed_tries")
NO_RESULTS = (
    "None are published with it. `adamanip report LOG --out FILE --command '...'`, then "
    "`adamanip push ... --results FILE`, adds them."
)


def results_table(results: Sequence[ResultFile]) -> str:
    """Returns the results section of a card: rates with 95 % Wilson intervals, and the evaluation commands."""
    return "\n\n".join(map(_table, results)) or NO_RESULTS


def _table(result: ResultFile) -> str:
    scenes = "scenes of no split" if result.scenes is None else f"scenes of the {result.scenes} split"
    titles = ["who", "category", "objects", "mechanisms", *(METRICS[name].title for name in _SHOWN)]
    rows = (
        [
            row.subject,
            words(row.category),
            row.objects,
            row.mechanism_rules,
            *(row.metrics.show(name) for name in _SHOWN),
        ]
        for row in result.rows
    )
    seeds = f"seeds {result.seeds[0]} to {result.seeds[1]}"
    commit = f"commit {result.commit or 'unknown'}{' with changes' * result.changed}"
    return (
        f"{result.title} ({scenes}, {seeds}):\n\n{markdown_table(titles, rows)}\n\n"
        f"Command: `{result.command}`; {commit}; version {result.version}; "
        f"simulation version {result.simulation_version}. Options are spelled as there, and later code may give other "
        "numbers."
    )


def eval_results(results: Sequence[ResultFile]) -> list[EvalResult]:
    """Returns results as rows of a card's `model-index`, each with its own scenes, seeds, counts and command.

    The Hub's library joins rows of equal identity and keeps the arguments of the first. So ``dataset_split`` names
    objects and scenes, and ``dataset_config`` numbers further results in the same scenes.
    """
    index = [_eval_result(each, row) for each in results for row in each.rows]
    same = Counter[tuple[Any, ...]]()
    for one in index:
        same[identity := one.unique_identifier] += 1
        if same[identity] > 1:
            one.dataset_config = f"{one.dataset_config}, result {same[identity]}"
    return index


def _eval_result(result: ResultFile, row: ResultRow) -> EvalResult:
    from huggingface_hub import EvalResult

    scenes = "scenes" if result.scenes is None else f"{result.scenes} scenes"
    return EvalResult(
        task_type="robotics",
        task_name="articulated manipulation under hidden state",
        dataset_type=f"adamanip_{row.category}",
        dataset_name=f"AdaManip {words(row.category)}, {row.objects} objects",
        dataset_config=row.mechanism_rules,
        dataset_split=f"{row.objects} objects, {scenes} {result.seeds[0]} to {result.seeds[1]}",
        dataset_args={
            "scenes": result.scenes,
            "seeds": list(result.seeds),
            "episodes": row.metrics.success.episodes,
            **success_summary(row.metrics.success),
            "command": result.command,
            "commit": result.commit,
            "changed": result.changed,
        },
        dataset_revision=f"simulation-version-{result.simulation_version}",
        metric_type="success_rate",
        metric_name=f"success rate ({row.subject})",
        metric_value=round(row.metrics.success.rate or 0.0, 4),
    )
