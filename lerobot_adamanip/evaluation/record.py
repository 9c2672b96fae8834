"""`EpisodeRecord`: what an episode was. Made by the environment, a line of the episode log, read by reports."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from lerobot_adamanip.assets import parse_asset_id
from lerobot_adamanip.catalog import category_of, is_asset_id, parse_object_id
from lerobot_adamanip.errors import AdaManipError

HiddenValue = bool | int | float


@dataclass(frozen=True)
class Provenance:
    """What made an episode.

    Attributes:
        fingerprint: hash of the code that decides episodes, see `lerobot_adamanip.fingerprint.combined`.
        version: of this package.
        run_id: one for all environments of an evaluation; None outside one.
        run_label: what the user called it, the policy's name for instance; None if not told.
        evaluation: which one of its run, from 0: an environment that meets an episode again has begun the next.
    """

    fingerprint: str
    version: str
    run_id: str | None = None
    run_label: str | None = None
    evaluation: int = 0


@dataclass(frozen=True, kw_only=True)
class EpisodeRecord:
    """One episode, as the environment's monitor saw it. Privileged: it tells the hidden state.

    A *try* is what `lerobot_adamanip.keyframes.KeyFrameLabels` calls one.

    Attributes:
        seed: decided object, poses and hidden state.
        split: of scenes, that the seed belongs to: ``train``, ``validation`` or ``test``; None for a seed of none.
        object_id: ``safe_007``.
        object_split: of objects: ``seen``, ``unseen`` or ``novel``; None for an external asset.
        hidden_state: as drawn, name -> value.
        success: whether it was opened.
        key_frames: steps it took.
        tries: key frames in which a joint was tried.
        blocked_pulls: failed tries at the joint that opens (door, lid, button of a lamp).
        wrong_turns: failed tries at the other joint (knob, button, cap, lever).
        key_moved: whether a try moved that other joint.
        first_part: name of the part of the first try, or None.
        first_try_failed: whether the first try failed.
        joints: name -> last position [rad or m].
        provenance: what made it.
    """

    seed: int
    split: str | None
    object_id: str
    object_split: str | None
    hidden_state: Mapping[str, HiddenValue]
    success: bool
    key_frames: int
    tries: int
    blocked_pulls: int
    wrong_turns: int
    key_moved: bool
    first_part: str | None
    first_try_failed: bool
    joints: Mapping[str, float] = field(default_factory=dict)
    provenance: Provenance

    @property
    def category(self) -> str:
        """Kind of object."""
        return category_of(self.object_id)

    @property
    def locked(self) -> bool | None:
        """Whether it started locked; None in a category that always has to be turned first."""
        value = self.hidden_state.get("locked")
        return None if value is None else bool(value)

    @property
    def failed_tries(self) -> int:
        """Tries that led nowhere."""
        return self.blocked_pulls + self.wrong_turns

    @property
    def identity(self) -> tuple[object, ...]:
        """What makes it the same episode as another, whoever acted in it."""
        return (self.seed, self.object_id, tuple(sorted(self.hidden_state.items())))

    @property
    def evaluation(self) -> tuple[str | None, str | None, int]:
        """What makes it part of the same evaluation as another: run, its label, and which evaluation of the run."""
        made = self.provenance
        return (made.run_id, made.run_label, made.evaluation)

    def to_json(self) -> dict[str, Any]:
        """Returns the record as a flat JSON object; ``category`` is written too, for other readers."""
        plain = {item.name: getattr(self, item.name) for item in fields(self) if item.name != "provenance"}
        mappings = {"hidden_state": dict(self.hidden_state), "joints": dict(self.joints)}
        return {**plain, "category": self.category, **mappings, **asdict(self.provenance)}

    @classmethod
    def from_json(cls, content: object) -> EpisodeRecord:
        """Returns the record in a decoded JSON object; raises ValueError that names what is wrong with it."""
        if not isinstance(content, dict):
            raise ValueError("not a JSON object")
        for name, check in _CHECKS.items():
            if name not in content:
                raise ValueError(f"no {name!r}")
            if not check(content[name]):
                raise ValueError(f"{name!r} is {content[name]!r}, which it cannot be")
        unknown = sorted(set(content) - set(_CHECKS))
        if unknown:
            raise ValueError(f"unknown {unknown[0]!r}")
        made = {item.name: content[item.name] for item in fields(Provenance)}
        own = {item.name: content[item.name] for item in fields(cls) if item.name != "provenance"}
        record = cls(**own, provenance=Provenance(**made))
        _check_agreement(record, content["category"])
        return record


def _check_agreement(record: EpisodeRecord, category: str) -> None:
    if category != record.category:
        raise ValueError(f"'category' is {category!r}, but the object is {record.object_id!r}")
    if record.failed_tries > record.tries or record.tries > record.key_frames:
        counts = f"{record.failed_tries} failed, {record.tries} tries, {record.key_frames} key frames"
        raise ValueError(f"its counts contradict each other: {counts}")
    if (record.first_part is None) != (record.tries == 0):
        raise ValueError(f"'first_part' is {record.first_part!r} after {record.tries} tries")


def _is_count(value: object) -> bool:
    # bool is an int to Python, but a count of True is garbage.
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_flag(value: object) -> bool:
    return isinstance(value, bool)


def _is_text(value: object) -> bool:
    return isinstance(value, str) and bool(value) and len(value) <= _LONGEST


def _is_text_or_none(value: object) -> bool:
    return value is None or _is_text(value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_hidden_state(value: object) -> bool:
    if not isinstance(value, dict) or not all(_is_text(name) for name in value):
        return False
    plain = all(_is_flag(each) or _is_number(each) for each in value.values())
    return plain and _is_flag(value.get("locked", False))


def _are_positions(value: object) -> bool:
    return isinstance(value, dict) and all(_is_text(name) and _is_number(each) for name, each in value.items())


def _is_object_id(value: object) -> bool:
    if not isinstance(value, str):
        return False
    try:
        (parse_asset_id if is_asset_id(value) else parse_object_id)(value)
    except AdaManipError:
        return False
    return True


_LONGEST = 200
_CHECKS: Mapping[str, Callable[[object], bool]] = {
    "seed": _is_count,
    "split": lambda value: value in (None, "train", "validation", "test"),
    "object_id": _is_object_id,
    "object_split": lambda value: value in (None, "seen", "unseen", "novel"),
    "category": _is_text,
    "hidden_state": _is_hidden_state,
    "success": _is_flag,
    "key_frames": _is_count,
    "tries": _is_count,
    "blocked_pulls": _is_count,
    "wrong_turns": _is_count,
    "key_moved": _is_flag,
    "first_part": _is_text_or_none,
    "first_try_failed": _is_flag,
    "joints": _are_positions,
    "fingerprint": _is_text,
    "version": _is_text,
    "run_id": _is_text_or_none,
    "run_label": _is_text_or_none,
    "evaluation": _is_count,
}
