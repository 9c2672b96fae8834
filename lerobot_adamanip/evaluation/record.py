"""Records of episodes, and the episode log (``--env.episode_log=FILE``) that holds them.

A log has one `EpisodeRecord` per JSON line, appended by the environments of many processes. It is the table that all
metrics are computed from.
"""

from __future__ import annotations

import contextlib
import json
import logging
import re
import reprlib
import statistics
import uuid
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

from lerobot_adamanip.assets import parse_asset_id
from lerobot_adamanip.catalog import category_of, is_asset_id, parse_object_id
from lerobot_adamanip.contract.control import CONTROLS, KEYFRAME
from lerobot_adamanip.contract.seeds import SPLITS
from lerobot_adamanip.contract.sensing import EXACT, SENSING_TEXT
from lerobot_adamanip.episode.options import POSES
from lerobot_adamanip.mechanisms import MECHANISM_RULES
from lerobot_adamanip.util import files, json_fields
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError, DatasetError, listed

LABEL = r"[^\r\n\x00-\x1f\u2028\u2029]{1,100}"
"""Check of an evaluation's label."""
HiddenValue = bool | int | float
TryMade = tuple[int, int, bool]
"""A try: joint index in the mechanism's `joints`, sign of the direction, whether it failed."""
Boundaries = Mapping[tuple[str, str], float]
"""(category, hidden name) -> median that halves a continuous range."""
LIMITS = {
    "max_key_frames": "lengths of episodes", "max_failed_tries": "limits of failed tries", "poses": "poses",
    "sensing": "errors of sensors", "hints": "shares of hints", "self_calibration": "self-calibrations",
    "control": "controls", "fps": "rates of control",
}  # fmt: skip
"""Field of a record that decides how hard its episode is -> what a warning calls its values."""
_STORED_RULES = "mechanism_preset"
"""Key of the mechanism rules in a log."""


_LONGEST = 200
_COUNT = json_fields.integer(0, 2**31)
_POSITION = json_fields.number(-1e9, 1e9)
_LINE = rf"[^\r\n]{{1,{_LONGEST}}}"
_TEXT = json_fields.text(_LINE, f"a line of at most {_LONGEST} characters")
_WORD = json_fields.text(r"[A-Za-z_][A-Za-z0-9_]{0,60}", "a name")


def _object_id(name: str, value: object) -> str:
    try:
        if isinstance(value, str) and len(value) <= _LONGEST:
            (parse_asset_id if is_asset_id(value) else parse_object_id)(value)
            return value
    except AdaManipError:
        pass
    raise ValueError(f"{name} is {reprlib.repr(value)}, not an object's id")


def _hidden_state(name: str, value: object) -> dict[str, HiddenValue]:
    values = json_fields.either(json_fields.flag, _POSITION)
    hidden: dict[str, HiddenValue] = json_fields.mapping(_WORD, values, 20)(name, value)
    json_fields.flag(f"{name}.locked", hidden.get("locked", False))
    return hidden


def _try(name: str, value: object) -> TryMade:
    joint, sign, failed = json_fields.listing(lambda _, entry: entry, 3, 3)(name, value)
    return (
        json_fields.integer(0, 1)(f"{name}[0]", joint),  # a mechanism has two joints
        json_fields.integer(-1, 1)(f"{name}[1]", sign),
        json_fields.flag(f"{name}[2]", failed),
    )


@dataclass(frozen=True)
class Provenance:
    """Software and run behind an episode.

    Attributes:
        simulation_version: see `lerobot_adamanip.contract.versions.SIMULATION_VERSION`.
        version: version of this package.
        mechanism_rules: rule set of the mechanisms, see `lerobot_adamanip.mechanisms`.
        run_id: shared by all environments of an evaluation; None outside one.
        run_label: label given by the user, for instance the policy's name; None without one.
        evaluation: index of the evaluation in its run, from 0. It grows when an environment repeats an episode.
        versions: installed versions, see `lerobot_adamanip.contract.versions.installed_versions`.
    """

    simulation_version: Annotated[int, json_fields.integer(1, 10**6)]
    version: Annotated[str, _TEXT]
    mechanism_rules: Annotated[str, json_fields.choice(tuple(MECHANISM_RULES))]
    run_id: Annotated[str | None, json_fields.optional(_TEXT)] = None
    run_label: Annotated[str | None, json_fields.optional(json_fields.text(LABEL, "a label"))] = None
    evaluation: Annotated[int, _COUNT] = 0
    versions: Annotated[Mapping[str, str], json_fields.mapping(_TEXT, _TEXT, 30)] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raises an error for a label or an id that a log cannot hold."""
        if self.run_id is not None and not re.fullmatch(_LINE, self.run_id):
            allowed = f"one line, 1 ... {_LONGEST} characters"
            raise ConfigurationError("Not a run_id.", got=f"{self.run_id!r:.80}", allowed=allowed, hint="run_id=None")
        if self.run_label is not None and not re.fullmatch(LABEL, self.run_label):
            got, allowed = f"{self.run_label!r:.80}", "one line, 1 ... 100 characters"
            raise ConfigurationError("Not a label.", got=got, allowed=allowed, hint="dp3_adaptive")


@dataclass(frozen=True, kw_only=True)
class EpisodeRecord:
    """One episode, as logged by the environment. Privileged: it contains the hidden state.

    `lerobot_adamanip.episode.tries` defines a *try*.

    Attributes:
        seed: seed of object, poses and hidden state.
        given_seed: seed from the evaluation. ``seed`` is its counterpart in the requested split, or another seed if the
            arm could not reach the first scene.
        split: scene split of the seed: ``train``, ``validation`` or ``test``; None outside all splits.
        object_id: ``safe_007``.
        object_split: ``seen``, ``unseen`` or ``novel``; None for an external asset.
        hidden_state: sampled values, name -> value.
        poses: preset of the poses.
        success: whether the object was opened.
        key_frames: number of steps: key frames, or commands at control rate.
        max_key_frames: number of steps allowed.
        clipped_goals: number of steps with a commanded position outside the arm's box.
        try_sequence: each try in order.
        max_failed_tries: failed tries allowed; None without a limit.
        joints: name -> final position [rad or m].
        repeat: number of the episodes in a row before this one that played the same scene, see ``--env.repeats``.
        sensing: errors of the sensors, see `lerobot_adamanip.contract.sensing`.
        hints: share of episodes whose instruction says what is hidden.
        episode: number in the recording, of an episode that the robot's twin recorded.
        seconds: simulated time, of an episode of the twin.
        self_calibration: whether the camera calibrated itself on the robot's hand.
        control: one of `contract.control.CONTROLS`.
        fps: steps per second at control rate [Hz]; None for key frames.
        provenance: software and run.
    """

    seed: Annotated[int, _COUNT]
    given_seed: Annotated[int, _COUNT]
    split: Annotated[str | None, json_fields.optional(json_fields.choice(tuple(SPLITS)))]
    object_id: Annotated[str, _object_id]
    object_split: Annotated[str | None, json_fields.optional(json_fields.choice(("seen", "unseen", "novel")))]
    hidden_state: Annotated[Mapping[str, HiddenValue], _hidden_state]
    poses: Annotated[str, json_fields.choice(POSES)]
    success: Annotated[bool, json_fields.flag]
    key_frames: Annotated[int, _COUNT]
    max_key_frames: Annotated[int, _COUNT]
    clipped_goals: Annotated[int, _COUNT]
    try_sequence: Annotated[tuple[TryMade, ...], json_fields.listing(_try, 0, 10_000)]
    max_failed_tries: Annotated[int | None, json_fields.optional(_COUNT)]
    joints: Annotated[Mapping[str, float], json_fields.mapping(_TEXT, _POSITION, 50)] = field(default_factory=dict)
    repeat: Annotated[int, _COUNT] = 0
    sensing: Annotated[str, json_fields.text(SENSING_TEXT, "a level of sensing with its parts")] = EXACT
    hints: Annotated[float, json_fields.number(0.0, 1.0)] = 0.0
    episode: Annotated[int | None, json_fields.optional(_COUNT)] = None
    seconds: Annotated[float | None, json_fields.optional(json_fields.number(0.0, 1e9))] = None
    self_calibration: Annotated[bool, json_fields.flag] = False
    control: Annotated[str, json_fields.choice(CONTROLS)] = KEYFRAME
    fps: Annotated[int | None, json_fields.optional(_COUNT)] = None
    provenance: Annotated[Provenance, json_fields.record(Provenance)]

    @property
    def category(self) -> str:
        """Category of the object."""
        return category_of(self.object_id)

    @property
    def locked(self) -> bool | None:
        """Whether it started locked; None in a category that always needs a turn first."""
        value = self.hidden_state.get("locked")
        return None if value is None else bool(value)

    @property
    def key_moved(self) -> bool:
        """Whether a try moved the joint that does not open (knob, button, cap, lever)."""
        return any(joint > 0 and not failed for joint, _, failed in self.try_sequence)

    @property
    def counted_tries(self) -> tuple[TryMade, ...]:
        """The tries, without pulls that stall after the part has given way: nothing is hidden there any more.

        In a row of locks a part that is held at the notch gives way only after the key has turned back.
        """
        counted, has_given_way, is_pulled = list[TryMade](), False, False
        hidden, is_row = self.hidden_state, self.provenance.mechanism_rules == "row"
        has_notch = is_row and bool(hidden.get("second_pulls")) and not hidden.get("third_pulls")
        for joint, sign, failed in self.try_sequence:
            if joint > 0 or not (failed and has_given_way):
                counted.append((joint, sign, failed))
            is_pulled |= joint == 0 and not failed
            has_notch &= not (is_pulled and not failed and (joint, sign) == (1, -hidden.get("direction", 0)))
            has_given_way |= joint == 0 and not failed and not has_notch
        return tuple(counted)

    @property
    def failed_tries(self) -> int:
        """Number of failed ones among `counted_tries`."""
        return sum(failed for _, _, failed in self.counted_tries)

    @property
    def identity(self) -> tuple[object, ...]:
        """Key of the episode, independent of the policy: its scene, and the settings that it was played with."""
        made_by = self.provenance.simulation_version, self.provenance.mechanism_rules
        return (self.scene, *made_by, *(getattr(self, name) for name in LIMITS))

    @property
    def scene(self) -> tuple[object, ...]:
        """Key of the scene, and of the repeat in it."""
        scene = (self.seed, self.object_id, tuple(sorted(self.hidden_state.items())))
        return (*scene, self.repeat) if self.repeat else scene

    @property
    def evaluation(self) -> tuple[str | None, str | None, int]:
        """Key of the evaluation: run, label, and index in the run."""
        return (self.provenance.run_id, self.provenance.run_label, self.provenance.evaluation)

    def to_json(self) -> dict[str, Any]:
        """Returns the record as a flat JSON object; includes ``category`` for other tools."""
        items = [item for item in fields(self) if item.name != "provenance"]
        own = {item.name: value for item in items if (value := getattr(self, item.name)) != item.default}
        mappings = {"hidden_state": dict(self.hidden_state), "joints": dict(self.joints)}
        tries = [list(each) for each in self.try_sequence]
        provenance = {key: getattr(self.provenance, name) for key, name in _PROVENANCE.items()}
        return {**own, "category": self.category, "try_sequence": tries, **mappings, **provenance}

    @classmethod
    def from_json(cls, content: Any) -> EpisodeRecord:
        """Returns the record in a decoded JSON object; raises ValueError that names the invalid field."""
        if lacking := [key for key in _ALWAYS if not isinstance(content, Mapping) or key not in content]:
            raise ValueError(f"the record lacks {', '.join(lacking)}")
        behind = {name: content[key] for key, name in _PROVENANCE.items()}
        own = {name: value for name, value in content.items() if name not in _PROVENANCE and name != "category"}
        record, category = _RECORD("the record", {**own, "provenance": behind}), content["category"]
        if category != record.category:
            raise ValueError(f"'category' is {category!r}, but the object is {record.object_id!r}")
        return record


_RECORD = json_fields.record(EpisodeRecord)
_PROVENANCE = {_STORED_RULES if item.name == "mechanism_rules" else item.name: item.name for item in fields(Provenance)}
_ALWAYS = (*_PROVENANCE, "category", "joints")


def new_run_id() -> str:
    """Returns a random id for one evaluation, shared by all its processes."""
    return uuid.uuid4().hex[:12]


def append_record(path: Path, record: EpisodeRecord) -> None:
    """Appends a record as one line; creates the folder if needed. Raises `DatasetError` if it cannot be written."""
    try:
        files.append_line(path, json.dumps(record.to_json()))
    except OSError as error:
        raise DatasetError(
            "An episode cannot be added to the episode log.",
            got=f"{path}: {error.strerror}",
            allowed="a file that can be written, on a disk with free space",
            hint="--env.episode_log=FILE on another disk",
        ) from error


def latest_evaluation(path: Path, run_id: str) -> tuple[int, set[tuple[object, ...]]]:
    """Returns the number of a run's latest evaluation in a log, and the identities of its episodes.

    Without any, the number is 0. Lines that cannot be read are skipped.
    """
    evaluation, identities = 0, set[tuple[object, ...]]()
    name = f'"run_id": {json.dumps(run_id)}'
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n") if path.is_file() else []
    for line in (each for each in lines if name in each):
        with contextlib.suppress(ValueError):
            record = EpisodeRecord.from_json(json_fields.parse(line))
            if record.provenance.evaluation > evaluation:
                evaluation, identities = record.provenance.evaluation, set()
            if record.provenance.evaluation == evaluation:
                identities.add(record.identity)
    return evaluation, identities


def read_log(path: Path) -> list[EpisodeRecord]:
    """Reads a log. Skips lines that are cut off or not JSON, and logs a warning that names them.

    Raises:
        DatasetError: the log is missing, holds no episode, or was written by another version.
    """
    advice = f"lerobot-eval --env.type=adamanip_safe --env.episode_log={path} ..."
    if path.is_dir():
        is_dataset = (path / "meta").is_dir()
        raise DatasetError(
            "This is a dataset, not an episode log." if is_dataset else "This is a folder, not an episode log.",
            got=path,
            allowed="a file that lerobot-eval --env.episode_log=FILE wrote",
            hint=f"adamanip stats {path}" if is_dataset else f"a file in {path}",
        )
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError as error:
        raise DatasetError(
            "Cannot read the episode log.", got=f"{path}: {error}", allowed="a file of JSON lines", hint=advice
        ) from error
    records, damaged = list[EpisodeRecord](), list[int]()
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            records.append(EpisodeRecord.from_json(json_fields.parse(line)))
        except json.JSONDecodeError:
            damaged.append(number)
        except ValueError as error:
            raise DatasetError(
                "This is no episode log of this version.",
                got=f"{path}, line {number}: {error}",
                allowed="one record per line, as the environments of this version write",
                hint=f"evaluate again: {advice}",
            ) from error
    if not records:
        what = "This is no episode log." if damaged else "The episode log is empty."
        raise DatasetError(what, got=path, allowed="at least one episode, as a line of JSON", hint=advice)
    if damaged:
        logging.getLogger(__name__).warning(
            "%s: skipped damaged lines (%s); their episodes are not counted", path, listed(damaged)
        )
    return records


def without_repeats(records: Iterable[EpisodeRecord]) -> list[EpisodeRecord]:
    """Returns the records without repeated episodes; of equal episodes, the last one stays.

    Episodes are equal if seed, object, hidden state and settings are. A seed on seen and on unseen objects is two.
    """
    last: dict[tuple[object, ...], EpisodeRecord] = {}
    for record in records:
        last.pop(record.identity, None)
        last[record.identity] = record
    return list(last.values())


def mixed_settings(records: Iterable[EpisodeRecord]) -> dict[str, tuple[str, ...]]:
    """Returns the fields in `LIMITS` with more than one value in an evaluation: name -> values, as text."""
    values: dict[str, dict[object, set[str]]] = {name: {} for name in LIMITS}
    for record in records:
        # The limit `best` differs by mechanism.
        mechanism = record.category, record.provenance.mechanism_rules, frozenset(record.hidden_state)
        for name, seen in values.items():
            where = mechanism if name == "max_failed_tries" else None
            seen.setdefault(where, set()).add(str(getattr(record, name)))
    return {
        name: tuple(sorted(set().union(*seen.values())))
        for name, seen in values.items()
        if any(len(each) > 1 for each in seen.values())
    }


def split_evaluations(records: Iterable[EpisodeRecord], *, pool: bool = False) -> list[list[EpisodeRecord]]:
    """Returns the records of each `EpisodeRecord.evaluation` in a log, in order of appearance.

    Labels and scene splits stay separate, even if ``pool`` merges evaluations.
    """
    evaluations: dict[tuple[object, ...], list[EpisodeRecord]] = {}
    for record in records:
        evaluation = record.provenance.run_label if pool else record.evaluation
        evaluations.setdefault((evaluation, record.split), []).append(record)
    return list(evaluations.values())


def first_episodes(records: Iterable[EpisodeRecord], count: int) -> list[EpisodeRecord]:
    """Returns the first ``count`` episodes of each evaluation and category, as ``lerobot-eval`` counts them.

    LeRobot runs ``ceil(n_episodes / batch_size)`` whole batches with consecutive seeds and counts the ``n_episodes``
    with the lowest seeds. The log also contains the surplus of the last batch, unless ``--env.logged_seeds`` excludes
    it.
    (LeRobot 0.6.1, `lerobot.scripts.lerobot_eval.eval_policy`.)
    """
    groups: dict[tuple[object, ...], list[EpisodeRecord]] = {}
    for record in records:
        groups.setdefault((record.evaluation, record.category), []).append(record)
    chosen = []
    for group in groups.values():
        seeds = set(sorted({record.given_seed for record in group})[:count])
        chosen += [record for record in group if record.given_seed in seeds]
    return chosen


def hidden_boundaries(states: Iterable[tuple[str, Mapping[str, HiddenValue]]]) -> dict[tuple[str, str], float]:
    """Returns the medians of the continuous hidden values by category and name, to three digits.

    Args:
        states: category and hidden state of each episode. Evaluations are comparable only with equal boundaries: pass
            the episodes of all of them.
    """
    values: dict[tuple[str, str], list[float]] = {}
    for category, hidden in states:
        for name, value in hidden.items():
            if isinstance(value, float):
                values.setdefault((category, name), []).append(value)
    return {key: float(f"{statistics.median(several):.3g}") for key, several in values.items()}


def hidden_names(category: str, hidden: Mapping[str, HiddenValue], boundaries: Boundaries) -> Iterator[str]:
    """Yields the names of a hidden state's values: ``locked``, ``direction +1``, ``mode 2``, ``turn_range < 1.1``."""
    for name, value in sorted(hidden.items()):
        if isinstance(value, bool):
            yield name if value else ("unlocked" if name == "locked" else f"not {name}")
        elif isinstance(value, float):
            boundary = boundaries[category, name]
            yield f"{name} {'<' if value < boundary else '>='} {boundary:g}"
        else:
            yield f"{name} {value:+d}" if name == "direction" else f"{name} {value}"
