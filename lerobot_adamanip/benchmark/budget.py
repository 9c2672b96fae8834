"""Table of what each method was given (data, steps, minutes, parameters), and how its loss changes at the end."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from lerobot_adamanip.benchmark.plan import COLLECT, CORRECT, TRAIN
from lerobot_adamanip.benchmark.report import BenchmarkReport
from lerobot_adamanip.benchmark.result import CellResult
from lerobot_adamanip.benchmark.training_log import TrainingLog
from lerobot_adamanip.catalog import parse_object_selection
from lerobot_adamanip.evaluation.text_format import counted, markdown_table

TITLES = ("method", "learns from", "steps x batch", "minutes of a core", "parameters", "loss, last fifth")
_EXPLANATION = (
    "Means over the trainings of a method's cells. Minutes are of corrections and trainings, and depend on the machine "
    "and on what else it did. The last column is the change of the training loss from the last but one fifth of the "
    "last training to its last fifth: a loss that falls there has not converged."
)


def budget_table(report: BenchmarkReport) -> str:
    """Returns the budgets of all trained methods as Markdown; empty without any."""
    rows = []
    for row in report.rows_with_results:
        results = [each for each in report.results if each.cell.method == row.name and each.cell.trials is None]
        if trained := [each for each in results if TRAIN in each.steps]:
            rows.append([row.title, _data(trained), _steps(trained[0]), *_costs(trained)])
    return f"{markdown_table(TITLES, rows)}\n\n{_EXPLANATION}" if rows else ""


def mean_losses(report: BenchmarkReport, method: str) -> list[float]:
    """Returns the loss in equal parts of a method's last training, as a share of its first value.

    The geometric mean over the trainings of its cells; empty without a log.
    """
    logs = _last_trainings([each for each in report.results if each.cell.method == method and each.cell.trials is None])
    shares = [[loss / log.losses[0] for loss in log.losses] for log in logs if min(log.losses) > 0]
    return [statistics.geometric_mean(part) for part in zip(*shares, strict=True)]


def _last_trainings(results: Sequence[CellResult]) -> list[TrainingLog]:
    """Returns the logs of the last training of each result that has one."""
    names = [[name for name, _ in result.options_of(TRAIN)][-1:] for result in results]
    both = zip(results, names, strict=True)
    return [result.trainings[last] for result, found in both for last in found if last in result.trainings]


def _data(results: Sequence[CellResult]) -> str:
    """Returns the kind and mean number of demonstrations, and what else the trainings use."""
    first = {kind: [options for _, options in results[0].options_of(kind)] for kind in (COLLECT, TRAIN)}
    demonstrations, corrections = (
        sum(_recorded(options) for each in results for _, options in each.options_of(kind)) / len(results)
        for kind in (COLLECT, CORRECT)
    )
    parts = [f"{demonstrations:.0f} {first[COLLECT][0]['--expert']} demonstrations"]
    parts += [f"{corrections:.0f} corrections"] if corrections else []
    parts += {f"images of {options['--image-size']} px" for options in first[COLLECT] if "--image-size" in options}
    weights = "--policy.pretrained_backbone_weights"
    is_pretrained = any(options.get(weights, "null") != "null" for options in first[TRAIN])
    return ", ".join([*parts, *(["a pretrained backbone"] if is_pretrained else [])])


def _recorded(options: dict[str, str]) -> int:
    """Returns the number of episodes that a collection records."""
    objects = parse_object_selection(options["--category"], options["--objects"])
    return len(objects) * int(options["--episodes-per-object"])


def _steps(result: CellResult) -> str:
    """Returns the steps of a result's trainings, the last one first if they are of several categories."""
    trainings = [options for _, options in result.options_of(TRAIN)]
    steps = [each["--steps"] for each in trainings]
    data = [options for _, options in result.options_of(COLLECT)]
    shown = " + ".join(steps) if len(data) == 1 else f"{steps[-1]}, after {counted(len(steps) - 1, 'training')}"
    return f"{shown} x {trainings[-1]['--batch_size']}"


def _costs(results: Sequence[CellResult]) -> list[str]:
    """Returns minutes of a core, parameters, and the change of the loss, as texts."""
    paid = [
        sum(
            result.costs[name].seconds * result.costs[name].machine["cores"] / 60
            for kind in (CORRECT, TRAIN)
            for name, _ in result.options_of(kind)
            if name in result.costs
        )
        for result in results
    ]
    logs = _last_trainings(results)
    if not logs:
        return [f"{sum(paid) / len(paid):.0f}", "-", "-"]
    change = sum(log.change for log in logs) / len(logs)
    return [f"{sum(paid) / len(paid):.0f}", f"{logs[0].parameters / 1e6:.1f} million", f"{100 * change:+.0f} %"]
