"""`adamanip report`: reports success rates with intervals, tries and plots of evaluations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from lerobot_adamanip.cli.arguments import print_result, require_suffix
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:
    from lerobot_adamanip.evaluation.record import EpisodeRecord

_RESULT = ".json"
SURPLUS = (
    "All episodes of the logs are counted. lerobot-eval counts the first --eval.n_episodes=N: report --episodes N."
)
type Evaluations = dict[str, list[EpisodeRecord]]


@dataclass
class ReportCommand:
    """Reports evaluations from their episode logs, which `lerobot-eval --env.episode_log=FILE` writes.

    Each evaluation in a log gets a column. Each episode (seed, object and hidden state) counts once, with its last
    record. All columns are compared with the first one.
    """

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Episode logs to read."""

    label: tuple[str, ...] = ()
    """Names of the logs, in their order. Default: file names."""

    episodes: int | None = None
    """Number of episodes to count per evaluation and category, first by seed. Default: all. Use the value of
    --eval.n_episodes: the log also holds the surplus of the last batch, which `lerobot-eval` ignores."""

    pool: bool = False
    """Count all evaluations of one label and scene split in a log together."""

    out: tuple[Path, ...] = ()
    """Files to write: a plot (.png, .pdf or .svg) of success by group and over episodes, or a result file (.json) for
    scripts/make_results.py and `adamanip push`. A result file needs --command."""

    command: str | None = None
    """Command of the evaluation, as typed in the repository's root, for the result file."""

    title: str = "success of policies"
    """Title in the result file, one line."""

    json: bool = False
    """Print one JSON object instead of tables."""

    def run(self) -> int:
        """Reads, prints, plots and writes. Returns 0."""
        labels = self._labels()
        self._check()
        from lerobot_adamanip.evaluation.record import read_log
        from lerobot_adamanip.evaluation.report import compare

        logs = {label: read_log(path) for label, path in zip(labels, self.logs, strict=True)}
        evaluations: Evaluations = {}
        for label, records in self._evaluations(logs):
            if label in evaluations:
                raise ConfigurationError(
                    "Two evaluations have one name.", got=label, allowed="a name for each", hint="--label FIRST SECOND"
                )
            evaluations[label] = records
        comparison = compare(evaluations)
        for path in self.out:
            self._write(evaluations, path)
        few = list(self._too_few(evaluations)) if self.episodes else []
        surplus = [f"Warning: {warning}" for warning in few] if self.episodes else [SURPLUS]
        lines = (*comparison.lines(), *surplus, *(f"written: {path}" for path in self.out))
        text = "\n".join((comparison.title, "", comparison.table(), "", *lines))
        result = comparison.to_json()
        result["warnings"] += few
        print_result(self.json, {**result, "out": self.out}, text)
        return 0

    def _write(self, evaluations: Evaluations, path: Path) -> None:
        if path.suffix.lower() != _RESULT:
            from lerobot_adamanip.evaluation.plots import plot_evaluations

            plot_evaluations(evaluations, path)
            return
        from lerobot_adamanip.evaluation.results import policy_result, write_result

        write_result(path, policy_result(evaluations, title=self.title, command=str(self.command)))

    def _check(self) -> None:
        results = [path for path in self.out if path.suffix.lower() == _RESULT]
        for path in self.out:
            require_suffix(path, (".png", ".pdf", ".svg", _RESULT), "curve.png")
            if path.resolve() in {log.resolve() for log in self.logs}:
                raise ConfigurationError(
                    "This would replace an episode log.", got=path, allowed="another file", hint="--out result.json"
                )
        if self.episodes is not None and self.episodes < 1:
            raise ConfigurationError("Nothing to count.", got=self.episodes, allowed=">= 1", hint="--episodes 100")
        if results and not self.command:
            hint = "--command 'lerobot-eval --policy.path=... --env.type=... '"
            raise ConfigurationError("A result needs its command.", got=self.command, allowed="one line", hint=hint)

    def _labels(self) -> list[str]:
        if not self.logs:
            raise ConfigurationError(
                "No episode log given.", got="nothing", allowed="one or more files", hint="adamanip report LOG"
            )
        paths = [path.resolve() for path in self.logs]
        if len(set(paths)) < len(paths):
            raise ConfigurationError(
                "An episode log is given twice.",
                got=", ".join(map(str, self.logs)),
                allowed="each log once; its evaluations get a column each",
                hint=f"adamanip report {' '.join(dict.fromkeys(map(str, self.logs)))}",
            )
        if not self.label:
            stems = [path.stem for path in self.logs]
            return stems if len(set(stems)) == len(stems) else [str(path) for path in self.logs]
        if len(self.label) != len(self.logs) or len(set(self.label)) != len(self.label):
            got = f"{len(self.label)} labels ({', '.join(self.label)}) for {len(self.logs)} logs"
            raise ConfigurationError(
                "Labels do not fit.", got=got, allowed="one per log, all different", hint="--label adaptive static"
            )
        return list(self.label)

    def _too_few(self, evaluations: Evaluations) -> Iterator[str]:
        """Yields a warning for each evaluation and category with fewer episodes than ``--episodes``."""
        for label, records in evaluations.items():
            episodes = {(record.category, record.given_seed) for record in records}
            for category, count in Counter(category for category, _ in sorted(episodes)).items():
                if self.episodes is not None and count < self.episodes:
                    yield f"{label}: {count} episodes of {category}, not {self.episodes}"

    def _evaluations(self, logs: Evaluations) -> Iterator[tuple[str, list[EpisodeRecord]]]:
        """Yields label and records of each evaluation. Several in one log are numbered."""
        from lerobot_adamanip.evaluation.record import first_episodes, split_evaluations

        for label, records in logs.items():
            chosen = records if self.episodes is None else first_episodes(records, self.episodes)
            parts = split_evaluations(chosen, pool=self.pool)
            for number, part in enumerate(parts, start=1):
                run_label = part[0].provenance.run_label
                name = f"{number} {run_label}" if run_label else str(number)
                yield (label if len(parts) == 1 else f"{label} #{name}"), part
