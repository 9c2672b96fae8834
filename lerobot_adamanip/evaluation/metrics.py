"""What an evaluation amounts to: success by group, with intervals, tries, failures by object. Pure functions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from lerobot_adamanip.evaluation.failures import count_failures
from lerobot_adamanip.evaluation.groups import ALL, Boundaries, Group, group_records
from lerobot_adamanip.evaluation.rates import Rate, rate
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.evaluation.recovery import Recovery, recovery
from lerobot_adamanip.mechanisms import fixed_direction

BEST_TRIES = {"locked": 1.0, "direction": 0.5, "mode": 1.0}
"""Tries in vain, on average, of the best strategy that sees nothing either. A pull tells that a door is locked, and is
cheaper than its key. A direction that is drawn is wrong half of the time. Of three motions, tried one after the other,
zero, one or two fail."""


@dataclass(frozen=True)
class Tries:
    """Tries that led nowhere, per *successful* episode: who does nothing, or gives up, tries little and is no better.

    Attributes:
        made: mean per success.
        best: the same mean, in the same episodes, of the best strategy that does not see the hidden state either.
        wasted: ``made - best``. Below zero: it succeeds where it guesses right, and fails where it does not.
    """

    made: float
    best: float
    wasted: float


@dataclass(frozen=True)
class GroupResult:
    """How a group of episodes went.

    Attributes:
        success: share that was opened.
        key_frames_of_successes: mean; None without a success.
        tries: of the successes; None without one.
    """

    success: Rate
    key_frames_of_successes: float | None
    tries: Tries | None


@dataclass(frozen=True)
class ObjectResult:
    """Episodes and failures on one object."""

    episodes: int
    failures: int


@dataclass(frozen=True)
class EvaluationSummary:
    """What an evaluation amounts to.

    Attributes:
        episodes: counted, each once.
        repeats: records dropped because the same episode came again later.
        groups: how each group went; `ALL` is always there, and first.
        tried_locked_first: of the episodes that started locked, those whose first try was a pull that failed.
        recovery: what follows a try that failed.
        objects: per object id, in order.
        failures: cause -> episodes; see `lerobot_adamanip.evaluation.failures`.
        fingerprints, versions, mechanism_rules: what made the episodes; one each, unless evaluations were mixed.
    """

    episodes: int
    repeats: int
    groups: Mapping[Group, GroupResult]
    tried_locked_first: Rate
    recovery: Recovery
    objects: Mapping[str, ObjectResult]
    failures: Mapping[str, int]
    fingerprints: tuple[str, ...]
    versions: tuple[str, ...]
    mechanism_rules: tuple[str, ...]

    @property
    def scenes(self) -> str:
        """Split of the episodes' scenes; of several, all with ``and`` between them."""
        return " and ".join(group.name for group in self.groups if group.by == "scenes")

    @property
    def overall(self) -> GroupResult:
        """All episodes."""
        return self.groups[ALL]

    def success(self, group: Group) -> Rate:
        """Returns a group's success; of no episodes where the group has none."""
        return self.groups[group].success if group in self.groups else rate(0, 0)


def without_repeats(records: Iterable[EpisodeRecord]) -> list[EpisodeRecord]:
    """Returns the records with each episode once, the last one winning, in the order of those kept.

    An episode is its seed, object and hidden state. One seed on seen and on unseen objects is two episodes.
    """
    last: dict[tuple[object, ...], EpisodeRecord] = {}
    for record in records:
        last.pop(record.identity, None)
        last[record.identity] = record
    return list(last.values())


def split_evaluations(records: Iterable[EpisodeRecord], *, pool: bool = False) -> list[list[EpisodeRecord]]:
    """Returns the records of each `EpisodeRecord.evaluation` that a log holds, in order of appearance.

    Splits of scenes stay apart, also where all evaluations are pooled into one.
    """
    found: dict[tuple[object, ...], list[EpisodeRecord]] = {}
    for record in records:
        found.setdefault((None if pool else record.evaluation, record.split), []).append(record)
    return list(found.values())


def first_episodes(records: Iterable[EpisodeRecord], count: int) -> list[EpisodeRecord]:
    """Returns the ``count`` episodes of each evaluation and category that ``lerobot-eval`` counts.

    LeRobot runs whole batches, ``ceil(n_episodes / batch_size)`` of them, gives the environments one seed after the
    other, and counts the first ``n_episodes``: those given the lowest seeds. A log holds the last batch's surplus too,
    unless ``--env.logged_seeds`` leaves it out.
    (LeRobot 0.6.1, `lerobot.scripts.lerobot_eval.eval_policy`.)
    """
    found: dict[tuple[object, ...], list[EpisodeRecord]] = {}
    for record in records:
        found.setdefault((record.evaluation, record.category), []).append(record)
    counted = [set(sorted({each.given_seed for each in group})[:count]) for group in found.values()]
    return [
        each for group, seeds in zip(found.values(), counted, strict=True) for each in group if each.given_seed in seeds
    ]


def tried_locked_first(record: EpisodeRecord) -> bool:
    """Whether a robot pulled first at a door that was locked."""
    return bool(record.locked) and record.first_part == "handle" and record.first_try_failed


def best_tries(record: EpisodeRecord) -> float:
    """Returns the tries in vain that the best strategy under the same uncertainty makes in this episode, on average."""
    if record.locked is False:
        return 0.0
    known = {"direction"} if fixed_direction(record.category, record.provenance.mechanism_rules) else set()
    return sum(cost for name, cost in BEST_TRIES.items() if name in record.hidden_state and name not in known)


def count_tries(records: Iterable[EpisodeRecord]) -> Tries | None:
    """Counts the failed tries of the successes, against the best possible under the same uncertainty.

    Made: each failed try; and working the key of what was not locked, one. Best: see `BEST_TRIES`.
    """
    solved = [record for record in records if record.success]
    if not solved:
        return None
    made = sum(record.failed_tries + (record.key_moved and record.locked is False) for record in solved) / len(solved)
    best = sum(map(best_tries, solved)) / len(solved)
    return Tries(made, best, made - best)


def group_result(records: Sequence[EpisodeRecord]) -> GroupResult:
    """Returns how a group of episodes went, each of them there once."""
    lengths = [record.key_frames for record in records if record.success]
    mean = sum(lengths) / len(lengths) if lengths else None
    return GroupResult(rate(len(lengths), len(records)), mean, count_tries(records))


def summarise(records: Sequence[EpisodeRecord], boundaries: Boundaries | None = None) -> EvaluationSummary:
    """Summarises the records of an evaluation, each episode counted once.

    Args:
        records: as read.
        boundaries: of continuous hidden values; see `lerobot_adamanip.evaluation.groups.hidden_boundaries`.
    """
    kept = without_repeats(records)
    locked = [record for record in kept if record.locked is True]
    made = [record.provenance for record in kept]
    return EvaluationSummary(
        episodes=len(kept),
        repeats=len(records) - len(kept),
        groups={group: group_result(chosen) for group, chosen in group_records(kept, boundaries).items()},
        tried_locked_first=rate(sum(map(tried_locked_first, locked)), len(locked)),
        recovery=recovery(kept),
        objects=_by_object(kept),
        failures=count_failures(kept),
        fingerprints=tuple(sorted({each.fingerprint for each in made})),
        versions=tuple(sorted({each.version for each in made})),
        mechanism_rules=tuple(sorted({each.mechanism_rules for each in made})),
    )


def _by_object(records: Sequence[EpisodeRecord]) -> dict[str, ObjectResult]:
    episodes = Counter(record.object_id for record in records)
    failures = Counter(record.object_id for record in records if not record.success)
    return {name: ObjectResult(episodes[name], failures[name]) for name in sorted(episodes)}


def warnings_of(summaries: Mapping[str, EvaluationSummary]) -> list[str]:
    """Returns what a reader of these numbers has to know: what was mixed, and what cannot be compared.

    Args:
        summaries: by label.
    """
    said = []
    for label, summary in summaries.items():
        if " and " in summary.scenes:
            said.append(f"{label}: {summary.scenes} scenes are mixed; a number is of one split")
        elif summary.scenes != "test":
            said.append(f"{label}: no test result, but one on {summary.scenes} scenes; lerobot-eval --env.split=test")
        if "train" in summary.scenes:
            said.append(f"{label}: scenes that demonstrations are recorded in are among these")
        for what, found in (("fingerprint", summary.fingerprints), ("set of rules", summary.mechanism_rules)):
            if len(found) > 1:
                said.append(f"{label}: its episodes are of more than one {what}: {', '.join(found)}")
    for what, sets in (
        ("fingerprints", [summary.fingerprints for summary in summaries.values()]),
        ("mechanism rules", [summary.mechanism_rules for summary in summaries.values()]),
        ("splits of scenes", [(summary.scenes,) for summary in summaries.values()]),
    ):
        if len(set(sets)) > 1:
            told = "; ".join(f"{label} {', '.join(one)}" for label, one in zip(summaries, sets, strict=True))
            said.append(f"not to be compared: {what} differ ({told})")
    return said
