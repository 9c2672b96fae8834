"""Result files: measured numbers with their provenance.

A file in ``results/`` is one JSON object; `scripts/make_results.py` turns all of them into the tables of the documents.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.versions import SIMULATION_VERSION, joined_versions
from lerobot_adamanip.evaluation.groups import OBJECT_SPLITS, without_repeats
from lerobot_adamanip.evaluation.metrics import Metrics, measure
from lerobot_adamanip.evaluation.provenance import LINE, MACHINE, VERSION_NUMBER, Origin, machine_class, present_origin
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.files import write_atomically
from lerobot_adamanip.util.json_fields import choice, integer, listing, number, optional, read, record, text
from lerobot_adamanip.util.machine_paths import MACHINE_PATH

KINDS = ("expert", "policy")
PRIVATE_PATH = re.compile(MACHINE_PATH + "|://|@")
"""Content that a published command must not have: local paths, addresses, users."""


@dataclass(frozen=True)
class ResultRow:
    """Result of one subject, set of mechanism rules, category and split of objects.

    Attributes:
        subject: expert or policy, as in tables: ``adaptive``, ``dp3_adaptive, adaptive demonstrations``.
        mechanism_rules: see `MECHANISM_RULES`; also those of earlier versions.
        category: category, for instance ``safe``.
        objects: one of `OBJECT_SPLITS`.
        metrics: of these episodes; failed and unreachable ones count too.
    """

    subject: Annotated[str, LINE]
    mechanism_rules: Annotated[str, text(r"[a-z_]{1,30}", "a name of mechanism rules")]
    category: Annotated[str, choice(tuple(CATEGORIES))]
    objects: Annotated[str, choice(OBJECT_SPLITS)]
    metrics: Annotated[Metrics, Metrics.from_json]

    def to_json(self) -> dict[str, Any]:
        """Returns a flat JSON-serialisable dictionary."""
        labels = {name: value for name, value in vars(self).items() if name != "metrics"}
        return {**labels, **self.metrics.to_json()}

    @classmethod
    def from_json(cls, name: str, content: object) -> ResultRow:
        """Returns the row in decoded JSON; raises ValueError that names the invalid field."""
        if not isinstance(content, Mapping):
            raise ValueError(f"{name} is not a row")
        labels = [item.name for item in fields(cls) if item.name in content]
        rest = {key: value for key, value in content.items() if key not in labels}
        return record(cls)(name, {**{key: content[key] for key in labels}, "metrics": rest})


@dataclass(frozen=True, kw_only=True)
class ResultFile(Origin):
    """A measurement.

    Attributes:
        kind: one of `KINDS`.
        title: description in one line.
        command: measuring command, as typed in the repository's root.
        simulation_version: of the episodes.
        machine: ``cores`` and ``gpu``, without a name.
        scenes: split of the scenes. ``seeds``: the first and the last.
        seconds: duration; None if not measured.
        rows: measured numbers.
    """

    kind: Annotated[str, choice(KINDS)]
    title: Annotated[str, LINE]
    command: Annotated[str, text(r"[^\r\n`]{1,2000}", "one line without backquotes")]
    simulation_version: Annotated[int, VERSION_NUMBER]
    machine: Annotated[Mapping[str, int | bool], MACHINE]
    scenes: Annotated[str | None, optional(choice(("test", "validation", "train")))]
    seeds: Annotated[tuple[int, int], listing(integer(0, 2**31), 2, 2)]
    seconds: Annotated[float | None, optional(number(0, 10**9))]
    rows: Annotated[tuple[ResultRow, ...], listing(ResultRow.from_json, 1, 10_000)]
    schema: Annotated[int, integer(1, 1)] = 1

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-serialisable dictionary."""
        return {**vars(self), "rows": [row.to_json() for row in self.rows]}


def check_command(command: str) -> str:
    """Returns a command that can be published; raises `ConfigurationError` if it contains a local path."""
    if PRIVATE_PATH.search(command):
        raise ConfigurationError(
            "A command in a result file must run elsewhere.",
            got=command,
            allowed="paths relative to the repository's root, no addresses, no users",
            hint="--command 'lerobot-eval --policy.path=outputs/train/... '",
        )
    return command


def rows_of_records(records: Sequence[EpisodeRecord], subject: str) -> list[ResultRow]:
    """Returns a row for each set of mechanism rules, category and split of objects in an evaluation."""
    found: dict[tuple[str, str, str], list[EpisodeRecord]] = {}
    for each in without_repeats(records):
        key = (each.provenance.mechanism_rules, each.category, each.object_split or "external")
        found.setdefault(key, []).append(each)

    def order(key: tuple[str, str, str]) -> tuple[str, int, int]:
        return key[0], tuple(CATEGORIES).index(key[1]), OBJECT_SPLITS.index(key[2])

    return [ResultRow(subject, *key, measure(found[key])) for key in sorted(found, key=order)]


def make_result(
    rows: Iterable[ResultRow],
    *,
    kind: str,
    title: str,
    command: str,
    seeds: Sequence[int],
    scenes: str | None,
    seconds: float | None = None,
    simulation_version: int = SIMULATION_VERSION,
    versions: Mapping[str, str] | None = None,
) -> ResultFile:
    """Returns a result with its origin and machine filled in.

    Args:
        rows: at least one.
        kind: one of `KINDS`.
        title: one line.
        command: as typed; raises `ConfigurationError` if it contains a local path.
        seeds: seeds of the episodes.
        scenes: split of the scenes.
        seconds: duration.
        simulation_version: of the episodes, if they were not simulated now.
        versions: installed versions then.
    """
    origin = asdict(present_origin())
    return ResultFile(
        kind=kind,
        title=title,
        command=check_command(command),
        simulation_version=simulation_version,
        **(origin if versions is None else {**origin, "versions": versions}),
        machine=machine_class(),
        scenes=scenes,
        seeds=(min(seeds), max(seeds)),
        seconds=None if seconds is None else round(seconds, 1),
        rows=tuple(rows),
    )


def policy_result(rows: Iterable[ResultRow], records: Sequence[EpisodeRecord], **given: Any) -> ResultFile:
    """Returns the result of policies' evaluations.

    Args:
        rows: from `rows_of_records`.
        records: records behind the rows.
        **given: ``title``, ``command`` and further arguments of `make_result`.

    Raises:
        ConfigurationError: several simulation versions or scene splits are mixed, or the command cannot be published.
    """
    made = sorted({(each.provenance.simulation_version, each.split) for each in records})
    if len(made) > 1:
        raise ConfigurationError(
            "A result file is of one simulation version and one split of scenes.",
            got="; ".join(f"simulation version {version}, split {split}" for version, split in made),
            allowed="episodes of one version and one split",
            hint="a new log, or a result file for each",
        )
    ((version, split),) = made
    return make_result(
        rows,
        **{"kind": "policy", **given},
        seeds=[each.seed for each in records],
        scenes=split,
        simulation_version=version,
        versions=joined_versions(each.provenance.versions for each in records),
    )


def write_result(path: Path, result: ResultFile) -> None:
    """Writes a result file; its content is validated as `read_result` does."""
    content = json.loads(json.dumps(result.to_json()))
    parse_result(content)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, (json.dumps(content, indent=1) + "\n").encode())


def read_result(path: Path) -> ResultFile:
    """Reads a result file; raises `DatasetError` if it is invalid."""
    try:
        return parse_result(read(path))
    except (OSError, ValueError) as error:
        raise DatasetError(
            "Not a result file.", got=f"{path}: {error}", allowed="what `write_result` writes", hint="measure again"
        ) from error


def parse_result(content: object) -> ResultFile:
    """Returns the result in decoded JSON; raises ValueError that names the invalid field."""
    found = record(ResultFile)("the result", content)
    if PRIVATE_PATH.search(found.command):
        raise ValueError("command holds a path of one machine")
    return found
