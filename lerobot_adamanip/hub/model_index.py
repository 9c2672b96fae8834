"""Results on a card: the table that people read, and the `model-index` that the Hub reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.datasets.cards.templates import table
from lerobot_adamanip.evaluation.log import read_log
from lerobot_adamanip.evaluation.rates import rate, success_summary
from lerobot_adamanip.evaluation.result_rows import ResultRow, rows_of_records
from lerobot_adamanip.evaluation.results import ResultFile, policy_result, read_result
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:
    from huggingface_hub import EvalResult

NONE = (
    "None are published with it. `adamanip report LOG --out FILE --command '...'`, then "
    "`adamanip push ... --results FILE`, adds them."
)


def read_results(paths: Sequence[Path], command: str | None = None) -> list[ResultFile]:
    """Reads results: files of ``adamanip report --out``, and episode logs (``.jsonl``).

    Args:
        paths: of the files.
        command: that made the episode logs, as typed; required for those, because no number goes without its command.

    Raises:
        DatasetError: a file is none of these.
        ConfigurationError: an episode log without a command, or of several codes or splits.
    """
    return [_of_log(path, command) if path.suffix == ".jsonl" else read_result(path) for path in paths]


def _of_log(path: Path, command: str | None) -> ResultFile:
    records = read_log(path)
    if not command:
        raise ConfigurationError(
            "Numbers are published with the command that made them.",
            got=f"{path.name} without a command",
            allowed="--results-command 'lerobot-eval ...', as typed",
            hint="or adamanip report LOG --out FILE --command '...', then --results FILE",
        )
    labels = {record.provenance.run_label for record in records} - {None}
    subject = " / ".join(sorted(map(str, labels))) or "policy"
    return policy_result(rows_of_records(records, subject), records, title="success", command=command)


def results_table(results: Sequence[ResultFile]) -> str:
    """Returns what a card says of results: rates with 95 % Wilson intervals, and what made them."""
    if not results:
        return NONE
    header = ("who", "category", "objects", "mechanisms", "success", "key frames", "failed tries")
    return "\n\n".join(
        f"{each.title} ({_scenes(each)}, seeds {each.seeds[0]} to {each.seeds[1]}):\n\n"
        + table(header, [_cells(row) for row in each.rows])
        + f"\n\nCommand: `{each.command}`; commit {each.commit or 'of a released version'}; version {each.version}; "
        f"fingerprint `{each.fingerprint}`."
        for each in results
    )


def _scenes(result: ResultFile) -> str:
    return "scenes of no split" if result.scenes is None else f"scenes of the {result.scenes} split"


def _cells(row: ResultRow) -> tuple[Any, ...]:
    found = rate(row.successes, row.episodes)
    share = "-" if found.rate is None else f"{100 * found.rate:.1f} % [{100 * found.low:.1f}, {100 * found.high:.1f}]"
    means = ["-" if value is None else f"{value:.1f}" for value in (row.key_frames, row.failed_tries)]
    category = row.category.replace("_", " ")
    return (row.subject, category, row.objects, row.preset, f"{row.successes}/{row.episodes}: {share}", *means)


def eval_results(results: Sequence[ResultFile]) -> list[EvalResult]:
    """Returns rows of results as the Hub's library takes them; it makes a card's `model-index` of them.

    A dataset's split there is ours of objects (seen, unseen, novel); the scenes' split and the seeds are arguments.
    """
    from huggingface_hub import EvalResult

    return [
        EvalResult(
            task_type="robotics",
            task_name="articulated manipulation under hidden state",
            dataset_type=f"adamanip_{row.category}",
            dataset_name=f"AdaManip {row.category.replace('_', ' ')}, {row.objects} objects",
            dataset_config=row.preset,
            dataset_split=row.objects,
            dataset_args={
                "scenes": each.scenes,
                "seeds": list(each.seeds),
                "episodes": row.episodes,
                **success_summary(rate(row.successes, row.episodes)),
                "command": each.command,
                "commit": each.commit,
            },
            dataset_revision=each.fingerprint,
            metric_type="success_rate",
            metric_name=f"success rate ({row.subject})",
            metric_value=round(row.successes / row.episodes, 4),
        )
        for each in results
        for row in each.rows
    ]
