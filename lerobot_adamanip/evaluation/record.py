"""`EpisodeRecord`: result of an episode. The environment writes it as a line of the episode log; reports read it."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from lerobot_adamanip.assets import parse_asset_id
from lerobot_adamanip.catalog import category_of, is_asset_id, parse_object_id
from lerobot_adamanip.contract.seeds import SPLITS
from lerobot_adamanip.episode.options import POSES, from_stored, to_stored
from lerobot_adamanip.mechanisms import MECHANISM_RULES
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError

LABEL = r"[^\r\n\x00-\x1f\u2028\u2029]{1,100}"
"""Check of an evaluation's label."""
HiddenValue = bool | int | float
TryMade = tuple[int, int, bool]
"""A try: joint index in the mechanism's `joints`, sign of the direction, whether it failed."""


@dataclass(frozen=True)
class Provenance:
    """Software and run behind an episode.

    Attributes:
        simulation_version: see `lerobot_adamanip.contract.versions.SIMULATION_VERSION`.
        version: of this package.
        mechanism_rules: rule set of the mechanisms, see `lerobot_adamanip.mechanisms`.
        run_id: shared by all environments of an evaluation; None outside one.
        run_label: label given by the user, for instance the policy's name; None without one.
        evaluation: index of the evaluation in its run, from 0. It grows when an environment repeats an episode.
        versions: installed versions, see `lerobot_adamanip.contract.versions.installed_versions`.
    """

    simulation_version: int
    version: str
    mechanism_rules: str
    run_id: str | None = None
    run_label: str | None = None
    evaluation: int = 0
    versions: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raises an error for a label that a log cannot hold."""
        if self.run_label is not None and not re.fullmatch(LABEL, self.run_label):
            raise ConfigurationError(
                "Not a label.", got=repr(self.run_label), allowed="one line, 1 ... 100 characters", hint="dp3_adaptive"
            )


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
        key_frames: number of steps.
        max_key_frames: number of steps allowed.
        clipped_goals: number of steps with a commanded position outside the arm's box.
        try_sequence: each try in order.
        max_failed_tries: failed tries allowed; None without a limit.
        joints: name -> final position [rad or m].
        provenance: software and run.
    """

    seed: int
    given_seed: int
    split: str | None
    object_id: str
    object_split: str | None
    hidden_state: Mapping[str, HiddenValue]
    poses: str
    success: bool
    key_frames: int
    max_key_frames: int
    clipped_goals: int
    try_sequence: tuple[TryMade, ...]
    max_failed_tries: int | None
    joints: Mapping[str, float] = field(default_factory=dict)
    provenance: Provenance

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
        """The tries, without pulls that stall after the part has given way: nothing is hidden there any more."""
        found, has_given_way = list[TryMade](), False
        for joint, sign, failed in self.try_sequence:
            if joint > 0 or not (failed and has_given_way):
                found.append((joint, sign, failed))
            has_given_way |= joint == 0 and not failed
        return tuple(found)

    @property
    def failed_tries(self) -> int:
        """Number of failed ones among `counted_tries`."""
        return sum(failed for _, _, failed in self.counted_tries)

    @property
    def identity(self) -> tuple[object, ...]:
        """Key of the episode, independent of the policy."""
        return (self.seed, self.object_id, tuple(sorted(self.hidden_state.items())))

    @property
    def evaluation(self) -> tuple[str | None, str | None, int]:
        """Key of the evaluation: run, label, and index in the run."""
        made = self.provenance
        return (made.run_id, made.run_label, made.evaluation)

    def to_json(self) -> dict[str, Any]:
        """Returns the record as a flat JSON object; includes ``category`` for other tools."""
        plain = {item.name: getattr(self, item.name) for item in fields(self) if item.name != "provenance"}
        mappings = {"hidden_state": dict(self.hidden_state), "joints": dict(self.joints)}
        sequence = [list(each) for each in self.try_sequence]
        made = to_stored(asdict(self.provenance))
        return {**plain, "category": self.category, "try_sequence": sequence, **mappings, **made}

    @classmethod
    def from_json(cls, content: object) -> EpisodeRecord:
        """Returns the record in a decoded JSON object; raises ValueError that names the invalid field."""
        found = from_stored(_RECORD("the record", content))
        own = {item.name: found[item.name] for item in fields(cls) if item.name != "provenance"}
        record = cls(**own, provenance=Provenance(**{item.name: found[item.name] for item in fields(Provenance)}))
        _check_agreement(record, found["category"])
        return record


def _check_agreement(record: EpisodeRecord, category: str) -> None:
    if category != record.category:
        raise ValueError(f"'category' is {category!r}, but the object is {record.object_id!r}")


def _object_id(name: str, value: object) -> str:
    try:
        if isinstance(value, str) and len(value) <= _LONGEST:
            (parse_asset_id if is_asset_id(value) else parse_object_id)(value)
            return value
    except AdaManipError:
        pass
    raise ValueError(f"{name} is {reprlib.repr(value)}, not an object's id")


def _hidden_state(name: str, value: object) -> dict[str, HiddenValue]:
    values = json_fields.either(json_fields.flag, json_fields.number(-1e9, 1e9))
    found: dict[str, HiddenValue] = json_fields.mapping(_WORD, values, 20)(name, value)
    json_fields.flag(f"{name}.locked", found.get("locked", False))
    return found


def _try(name: str, value: object) -> TryMade:
    joint, sign, failed = json_fields.listing(lambda _, entry: entry, 3, 3)(name, value)
    return (
        json_fields.integer(0, 20)(f"{name}[0]", joint),
        json_fields.integer(-1, 1)(f"{name}[1]", sign),
        json_fields.flag(f"{name}[2]", failed),
    )


_LONGEST = 200
_COUNT = json_fields.integer(0, 2**31)
_TEXT = json_fields.text(rf"[^\r\n]{{1,{_LONGEST}}}", f"a line of at most {_LONGEST} characters")
_WORD = json_fields.text(r"[A-Za-z_][A-Za-z0-9_]{0,60}", "a name")
_RECORD = json_fields.table(
    {
        "seed": _COUNT,
        "given_seed": _COUNT,
        "split": json_fields.optional(json_fields.choice(tuple(SPLITS))),
        "object_id": _object_id,
        "object_split": json_fields.optional(json_fields.choice(("seen", "unseen", "novel"))),
        "category": _WORD,
        "hidden_state": _hidden_state,
        "success": json_fields.flag,
        "key_frames": _COUNT,
        "max_key_frames": _COUNT,
        "max_failed_tries": json_fields.optional(_COUNT),
        "poses": json_fields.choice(POSES),
        "clipped_goals": _COUNT,
        "try_sequence": json_fields.listing(_try, 0, 10_000),
        "joints": json_fields.mapping(_TEXT, json_fields.number(-1e9, 1e9), 50),
        "simulation_version": json_fields.integer(1, 10**6),
        "version": _TEXT,
        "mechanism_preset": json_fields.choice(tuple(MECHANISM_RULES)),
        "run_id": json_fields.optional(_TEXT),
        "run_label": json_fields.optional(json_fields.text(LABEL, "a label")),
        "evaluation": _COUNT,
        "versions": json_fields.mapping(_TEXT, _TEXT, 30),
    }
)
