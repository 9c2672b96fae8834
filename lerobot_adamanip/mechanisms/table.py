"""Mechanism, rules and source in the paper of each category, one row per category."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.mechanisms.base import Mechanism
from lerobot_adamanip.mechanisms.composed import NOTCH, PLAY, ChangingMechanism, RowMechanism
from lerobot_adamanip.mechanisms.families import (
    BUTTON_RELEASE,
    KNOB_RANGE,
    TURN_RANGE,
    TURN_RELEASE,
    LampMechanism,
    MicrowaveMechanism,
    SafeMechanism,
    TurnToOpenMechanism,
)
from lerobot_adamanip.util.errors import ConfigurationError, require_choice

if TYPE_CHECKING:  # objects import scipy; every lerobot command imports this module
    from lerobot_adamanip.objects.base import ArticulatedObject

MECHANISM_RULES: Mapping[str, str] = {
    "paper": "what the paper's text says",
    "upstream": "what its released code does",
    "hard": "ours: the paper's, and every part that turns to open draws its direction",
    "row": "ours: three locks in a row; the motion that frees each is hidden",
    "changing": "ours: a lock that may shut again at the first pull, and then turns anew",
}
DEFAULT_MECHANISM_RULES = "paper"
LIFTED = 0.025
"""Distance beyond which a cap, lid or portafilter is off [m] (paper code)."""
SWUNG, SASH_SWUNG = math.pi / 7, math.pi / 6
"""Angles beyond which a door and a sash are open [rad] (paper code)."""
GOAL_MARGIN = 1.1
"""Least ratio of a joint's limit to its goal, because success means being beyond the goal."""
Build = Callable[["ArticulatedObject", float, bool], Mechanism[Any]]
Composed = Callable[["ArticulatedObject"], Mechanism[Any]]


@dataclass(frozen=True)
class CategoryRules:
    """One category's rules.

    Attributes:
        build: (object, probability of the positive direction, whether upstream's rules apply) -> mechanism.
        paper: quotation that the rules follow.
        reading: our interpretation of the quotation.
        fixed_direction: +1 or -1 if ``paper`` and ``upstream`` fix the key's direction; None if it is drawn, or
            there is none.
    """

    build: Build
    paper: str
    reading: str
    fixed_direction: int | None = None


def _ranges(obj: ArticulatedObject, key: str, final: str) -> dict[str, float]:
    return {"key_range": obj.joint(key).limits[1], "final_upper": obj.joint(final).limits[1]}


def _turn_to_open(key: str, final: str, success: float) -> Build:
    return lambda obj, p_positive, upstream: TurnToOpenMechanism(
        key, final, **_ranges(obj, key, final), success=success, p_positive=p_positive
    )


def _safe(obj: ArticulatedObject, p_positive: float, upstream: bool) -> SafeMechanism:
    door, knob = obj.joint("door").limits[1], obj.joint("knob").limits[1]
    return SafeMechanism(door, knob, SWUNG, p_positive=p_positive, lock_on_turn=upstream)


def _microwave(obj: ArticulatedObject, p_positive: float, upstream: bool) -> MicrowaveMechanism:
    return MicrowaveMechanism(obj.joint("door").limits[1], obj.joint("button").limits[1], SWUNG)


def _lamp(obj: ArticulatedObject, p_positive: float, upstream: bool) -> LampMechanism:
    return LampMechanism(obj.joint("button").limits[1], obj.joint("knob").limits[1])


_CAP = (
    "When rotating a knob, cap, or handle, the direction (i.e., clockwise or counterclockwise) is determined by the "
    "internal revolute joint limit. Our environment randomly assigns the rotation direction upon initialization (3.2). "
    "Grasp the Cap. Rotate Cap after a failed Lift Up. Randomly sample Rotate/Lift if the previous action is Rotate "
    "(appendix)."
)
_CAP_READING = (
    "Rotate & Slide, direction drawn: section 3.2 names caps, bottle and pen are all that have one, and the released "
    "code draws theirs; figure 2 and the appendix say nothing of a direction"
)
_WINDOW = "Randomly choose a direction to Rotate Handle. If failed, choose the other direction. Rotate Handle after a "
RULES: Mapping[str, CategoryRules] = {
    "bottle": CategoryRules(_turn_to_open("cap", "lift", LIFTED), _CAP, _CAP_READING),
    "pen": CategoryRules(_turn_to_open("cap", "lift", LIFTED), f"Same as Bottle (appendix). {_CAP}", _CAP_READING),
    "pressure_cooker": CategoryRules(
        _turn_to_open("lid", "lift", LIFTED),
        "Bottle and Pressure Cooker feature the Rotate & Slide mechanism, requiring continued rotation after a failed "
        "lift (figure 2). Grasp the Handle. Rotate Handle after a failed Lift Up. Randomly sample Rotate/Lift if the "
        "previous action is Rotate (appendix).",
        "Rotate & Slide alone; neither tries a direction, so it is fixed; + as in the released code",
        fixed_direction=1,
    ),
    "coffee_maker": CategoryRules(
        _turn_to_open("portafilter", "drop", LIFTED),
        "The pen and coffee machine in the upper right corner fall under the \"Rotate/Slide\" (appendix). Grasp "
        "Portafilter. Rotate Portafilter after a failed Pull Down. Randomly sample Rotate/Pull if the previous action "
        "is Rotate (appendix).",
        "Rotate & Slide alone; neither tries a direction, so it is fixed; - as in the released code",
        fixed_direction=-1,
    ),
    "safe": CategoryRules(
        _safe,
        "Pull Door. If succeed, then continue opening the door. If failed, Rotate Knob. Randomly choose a direction to "
        "Rotate and choose the other one if failed. Then Pull Door again to open it (appendix).",
        "Lock, Random Rotation Direction, Switch Contact",
    ),
    "microwave": CategoryRules(
        _microwave,
        "Microwave incorporates the Lock and Switch Contact mechanisms, where the robot must first pull the handle to "
        "check the lock state and press the button if locked (figure 2).",
        "Lock, Switch Contact",
    ),
    "window": CategoryRules(
        _turn_to_open("handle", "sash", SASH_SWUNG),
        "The window includes the Lock and Random Rotation Direction mechanisms, necessitating exploration of the "
        f"correct rotation direction to unlock the latch (figure 2). {_WINDOW}failed open trial (appendix).",
        "Lock, Random Rotation Direction; always locked",
    ),
    "door": CategoryRules(
        _turn_to_open("lever", "leaf", SWUNG),
        "The door at the bottom belongs to the \"Random Rotation Direction\" and \"Lock\", where the handle must be "
        "rotated either clockwise or counterclockwise to open the door (appendix).",
        "Lock, Random Rotation Direction; always locked",
    ),
    "lamp": CategoryRules(
        _lamp,
        "Randomly choose to Push/Clockwise Rotate/Counter Clockwise Rotate. Never choose a failed action (appendix).",
        "Push / Rotate",
    ),
}  # fmt: skip


def _row(key: str, final: str, success: float, fractions: tuple[float, float] = TURN_RANGE) -> Composed:
    return lambda obj: RowMechanism(
        key, final, **_ranges(obj, key, final), fractions=fractions, notch=NOTCH[obj.joint(final).kind], success=success
    )


def _changing(
    key: str,
    final: str,
    success: float,
    fractions: tuple[float, float] = TURN_RANGE,
    release: float = TURN_RELEASE,
    *,
    has_directions: bool = True,
) -> Composed:
    return lambda obj: ChangingMechanism(
        key,
        final,
        **_ranges(obj, key, final),
        fractions=fractions,
        release=release,
        play=PLAY[obj.joint(final).kind],
        success=success,
        has_directions=has_directions,
    )


_TURNED: Mapping[str, tuple[Any, ...]] = {
    "bottle": ("cap", "lift", LIFTED),
    "pen": ("cap", "lift", LIFTED),
    "pressure_cooker": ("lid", "lift", LIFTED),
    "coffee_maker": ("portafilter", "drop", LIFTED),
    "safe": ("knob", "door", SWUNG, KNOB_RANGE),
    "window": ("handle", "sash", SASH_SWUNG),
    "door": ("lever", "leaf", SWUNG),
}
COMPOSED: Mapping[str, Mapping[str, Composed]] = {
    "row": {name: _row(*parts) for name, parts in _TURNED.items()},
    "changing": {
        **{name: _changing(*parts) for name, parts in _TURNED.items()},
        "microwave": _changing("button", "door", SWUNG, (1.0, 1.0), BUTTON_RELEASE, has_directions=False),
    },
}
"""Rules that not every category has: rules -> category -> build. A lamp has no part that opens; the button of a
microwave moves one way only, and springs back."""
_UPSTREAM = ("safe",)
"""Categories in which upstream's code differs from the paper's text; a test compares the mechanisms."""


def categories_with(rules: str) -> tuple[str, ...]:
    """Returns the categories that have mechanism rules; raises `ConfigurationError` for unknown rules."""
    require_choice("mechanism rules", rules, MECHANISM_RULES)
    return tuple(name for name in RULES if name in COMPOSED.get(rules, RULES))


def rules_of(category: str) -> tuple[str, ...]:
    """Returns the mechanism rules that a category has."""
    return tuple(rules for rules in MECHANISM_RULES if category in categories_with(rules))


def require_rules(category: str, rules: str) -> str:
    """Returns ``rules``; raises `ConfigurationError` for unknown names, and if the category does not have them."""
    require_choice("category", category, RULES)
    if category not in (allowed := categories_with(rules)):
        raise ConfigurationError(
            f"The mechanism rules {rules!r} do not exist for this category.",
            got=category,
            allowed=", ".join(allowed),
            hint=f"--env.type=adamanip_{allowed[0]}, or --env.type=adamanip --env.categories={','.join(allowed)}",
        )
    return rules


def fixed_direction(category: str, rules: str = DEFAULT_MECHANISM_RULES) -> int | None:
    """Returns the direction of a category's key, +1 or -1, if it is equal in every episode; None if it is drawn.

    Raises `ConfigurationError` for an unknown category or rules.
    """
    row = RULES[require_choice("category", category, RULES)]
    is_drawn = require_choice("mechanism rules", rules, MECHANISM_RULES) in ("hard", *COMPOSED)
    return None if is_drawn else row.fixed_direction


def make_mechanism(obj: ArticulatedObject, rules: str = DEFAULT_MECHANISM_RULES) -> Mechanism[Any]:
    """Returns an object's mechanism, by its category; raises `ConfigurationError` for ``rules`` that it lacks."""
    if require_rules(obj.category, rules) in COMPOSED:
        if rules == "changing" and obj.category == "microwave" and not obj.joint("button").stiffness:
            raise ConfigurationError(
                "A button without a spring cannot be pushed again after the lock has shut.",
                got=obj.object_id,
                allowed="generated microwaves, or other rules than changing",
                hint="--env.mechanism_rules=paper",
            )
        return COMPOSED[rules][obj.category](obj)
    direction = fixed_direction(obj.category, rules)
    p_positive = 0.5 if direction is None else float(direction > 0)
    return RULES[obj.category].build(obj, p_positive, rules == "upstream")


def infeasible(obj: ArticulatedObject) -> str | None:
    """Returns the reason why an object can never be opened; None if it can.

    Every goal has to be within reach: the hidden state decides which of them an episode needs (lamp).
    """
    try:
        goals = make_mechanism(obj).goals
    except ConfigurationError as error:
        return str(error).splitlines()[0]
    for name, goal in goals.items():
        joint = obj.joint(name)
        far = max(abs(limit) for limit in joint.limits)
        if far < GOAL_MARGIN * goal:
            unit = "m" if joint.kind == "prismatic" else "rad"
            return f"joint {name} goes {far:.3g} {unit}, its goal is beyond {goal:.3g} {unit}"
    return None


def changed_categories(rules: str) -> tuple[str, ...]:
    """Returns the categories in which ``rules`` differ from the default ones."""
    if rules == "upstream":
        return _UPSTREAM
    if rules in COMPOSED:
        return tuple(COMPOSED[rules])
    return tuple(name for name in RULES if fixed_direction(name, rules) != fixed_direction(name))


def unchanged_rules(categories: Iterable[str], rules: str) -> str | None:
    """Returns a line naming the categories in which ``rules`` change nothing; None if there are none."""
    changed = changed_categories(rules)
    same = [name for name in dict.fromkeys(categories) if name not in changed]
    if rules == DEFAULT_MECHANISM_RULES or not same:
        return None
    return (
        f"The mechanism rules {rules} are the {DEFAULT_MECHANISM_RULES} rules for {', '.join(same)}. "
        f"They change {', '.join(changed)} only."
    )
