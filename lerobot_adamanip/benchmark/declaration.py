"""Declaration of a benchmark: methods, what they learn from, and scales. Read from TOML, checked field by field."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from lerobot_adamanip.benchmark.declaration_fields import DECLARATION, DEMONSTRATIONS, METHOD, ROUND, SCALE, TRIALS
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.episode.options import DEFAULT_LATE_STARTS, POSES
from lerobot_adamanip.experts import EXPERT_STRATEGIES
from lerobot_adamanip.mechanisms import DEFAULT_MECHANISM_RULES
from lerobot_adamanip.util.errors import ConfigurationError, require_choice
from lerobot_adamanip.util.json_fields import Check, choice, table

PAPER_TABLE = Path(__file__).with_name("paper_table.toml")
"""The declaration that is used where no other is given."""
METHODS_GROUP = "lerobot_adamanip.benchmark_methods"
"""Entry points by which other packages declare methods: each is what a table ``[methods.NAME]`` would be."""


@dataclass(frozen=True, kw_only=True)
class Demonstrations:
    """A set of demonstrations, of each category; fields as of `lerobot_adamanip.cli.collect.Collect`.

    ``num_points``, ``image_size`` (0: no pictures), ``poses`` and ``mechanism_rules`` hold in evaluations too.
    """

    expert: str = "adaptive"
    expert_strategy: str = EXPERT_STRATEGIES[0]
    trials: int = 1
    late_starts: float = DEFAULT_LATE_STARTS
    num_points: int = schema.DEFAULT_NUM_POINTS
    image_size: int = 0
    poses: str = POSES[0]
    mechanism_rules: str = DEFAULT_MECHANISM_RULES


@dataclass(frozen=True, kw_only=True)
class Round:
    """A round of corrections (DAgger): the policy drives, the expert corrects it, and it is trained on all there is.

    Attributes:
        corrections: corrected episodes, per category.
        steps: of the training.
        start: ``new`` weights, or those that were ``trained`` before.
    """

    corrections: int
    steps: int
    start: str = "new"


@dataclass(frozen=True, kw_only=True)
class Method:
    """A row of the table.

    Attributes:
        title: its name in tables.
        policy: ``--policy.type``.
        options: ``--policy.NAME=VALUE`` options that it is made with.
        demonstrations: name of the set that it is trained on; empty for a policy that needs no training.
        rounds: of corrections, after that training.
        train: further options of ``lerobot-train``; they win over the scale's.
        evaluate: further options of ``lerobot-eval``, likewise.
        steps: of its training, by scale, where they are not the scale's.
        train_at: by scale, options of ``lerobot-train`` that win over ``train``.
        paper: its name in the paper; empty if it is not there.
        package: the distribution that declares it; empty for the declaration's own.
    """

    title: str
    policy: str
    options: tuple[str, ...] = ()
    demonstrations: str = ""
    rounds: tuple[Round, ...] = ()
    train: tuple[str, ...] = ()
    evaluate: tuple[str, ...] = ()
    steps: Mapping[str, int] = field(default_factory=dict)
    train_at: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    paper: str = ""
    package: str = ""


@dataclass(frozen=True, kw_only=True)
class Scale:
    """How much of everything.

    Attributes:
        categories, splits, seeds: the cells; ``splits`` are of objects, ``seeds`` of trainings.
        objects: that demonstrations are of, and that the split ``seen`` stands for.
        demonstrations: per category.
        steps, batch_size: of a training.
        save_every: steps between checkpoints; an interrupted training resumes from the last one. Decides no result.
        episodes: of an evaluation; ``environments`` run at once.
        device: of torch.
        poses: of all scenes; empty for those of each set of demonstrations.
        evaluate: options of ``lerobot-eval``; those of a method win.
        note: one sentence for its report; ``beside_paper``: whether the paper's numbers stand there. Both decide no
            result.
    """

    objects: str
    demonstrations: int
    steps: int
    batch_size: int
    save_every: int
    episodes: int
    environments: int
    device: str
    poses: str = ""
    evaluate: tuple[str, ...] = ()
    categories: tuple[str, ...] = tuple(CATEGORIES)
    splits: tuple[str, ...] = ("seen", "unseen")
    seeds: tuple[int, ...] = (1000,)
    note: str = ""
    beside_paper: bool = True


@dataclass(frozen=True, kw_only=True)
class TrialsCurve:
    """A method on demonstrations of more and more failed trials, the paper's second table.

    Attributes:
        method: name.
        numbers: of trials.
        none: set of demonstrations that stands for no trial.
        categories, splits, scales: where the curve is measured.
    """

    method: str
    numbers: tuple[int, ...]
    none: str
    categories: tuple[str, ...]
    splits: tuple[str, ...]
    scales: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """A benchmark.

    Attributes:
        reference: the method that every other one is compared with.
        scales, demonstrations, methods: by name, in order.
        trials: None if no such curve is wanted.
    """

    reference: str
    scales: Mapping[str, Scale]
    demonstrations: Mapping[str, Demonstrations]
    methods: Mapping[str, Method]
    trials: TrialsCurve | None = None

    def scale(self, name: str) -> Scale:
        """Returns a scale by its name; raises `ConfigurationError` if there is none."""
        return self.scales[require_choice("scale", name, self.scales)]


def read_declaration(path: Path = PAPER_TABLE) -> Declaration:
    """Reads a declaration, without methods of other packages; raises `ConfigurationError` if it is none."""
    try:
        return parse_declaration(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            "Not a declaration of a benchmark.",
            got=f"{path}: {error}",
            allowed="see docs/benchmark.md",
            hint=PAPER_TABLE.name,
        ) from error


def parse_declaration(content: Mapping[str, Any]) -> Declaration:
    """Returns the declaration in decoded TOML; raises ValueError that names what is wrong with it."""
    found = DECLARATION("the declaration", {"trials": {}, **content})
    made = Declaration(
        reference=found["reference"],
        scales={name: _made(Scale, SCALE, f"scales.{name}", each) for name, each in found["scales"].items()},
        demonstrations={
            name: _made(Demonstrations, DEMONSTRATIONS, f"demonstrations.{name}", each)
            for name, each in found["demonstrations"].items()
        },
        methods={name: _method(f"methods.{name}", each) for name, each in found["methods"].items()},
        trials=TrialsCurve(**TRIALS("trials", found["trials"])) if found["trials"] else None,
    )
    _check_names(made)
    return made


def with_packages(declaration: Declaration) -> Declaration:
    """Returns a declaration with the methods that installed packages declare; raises `ConfigurationError`."""
    methods = dict(declaration.methods)
    for point in sorted(entry_points(group=METHODS_GROUP)):
        methods[point.name] = _declared_by(point, declaration)
    return replace(declaration, methods=methods)


def _declared_by(point: EntryPoint, declaration: Declaration) -> Method:
    package = point.dist.name if point.dist is not None else point.module
    try:
        if point.name in declaration.methods:
            raise ValueError("the declaration has a method of that name")
        method = _method(point.name, dict(point.load()))
        _check_method(declaration, point.name, method)
    except Exception as error:  # other packages may raise anything when they are imported
        raise ConfigurationError(
            f"The benchmark method {point.name!r} cannot be used.",
            got=f"{point.value} of {package}: {error}",
            allowed="a table like [methods.NAME], see docs/extending_policy.md",
            hint=f"repair {package}, or uninstall it",
        ) from error
    return replace(method, package=package)


def _method(name: str, given: Mapping[str, Any]) -> Method:
    method = _made(Method, METHOD, name, given)
    rounds = (_made(Round, ROUND, f"{name}.rounds[{place}]", each) for place, each in enumerate(method.rounds))  # type: ignore[arg-type]
    return replace(method, rounds=tuple(rounds))


def _made[Made](kind: type[Made], check: Mapping[str, Check], name: str, given: Mapping[str, Any]) -> Made:
    """Returns a dataclass of given fields and defaults, all of them checked."""
    values = dict(given)
    for item in fields(kind):  # type: ignore[arg-type]
        if item.name in check and item.default is not MISSING:
            values.setdefault(item.name, item.default)
        elif item.name in check and item.default_factory is not MISSING:
            values.setdefault(item.name, item.default_factory())
    return kind(**table(check)(name, values))


def _check_names(made: Declaration) -> None:
    _require("reference", made.reference, made.methods)
    for name, method in made.methods.items():
        _check_method(made, name, method)
    if (curve := made.trials) is not None:
        _require("trials.method", curve.method, made.methods)
        _require("trials.none", curve.none, made.demonstrations)
        learnt = made.methods[curve.method].demonstrations
        _require(f"methods.{curve.method}.demonstrations", learnt, made.demonstrations)
        for scale in curve.scales:
            _require("trials.scales", scale, made.scales)


def _check_method(made: Declaration, name: str, method: Method) -> None:
    _require(f"methods.{name}.demonstrations", method.demonstrations, ("", *made.demonstrations))
    if method.rounds and not method.demonstrations:
        raise ValueError(f"methods.{name}.rounds are of a method without demonstrations")
    for scale in (*method.steps, *method.train_at):
        _require(f"methods.{name}.steps and train_at", scale, made.scales)


def _require(name: str, got: str, names: Iterable[str]) -> None:
    choice(tuple(names))(name, got)
