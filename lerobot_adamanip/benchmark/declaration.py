"""What a benchmark consists of: methods, what they learn from, and scales. Read from TOML, checked field by field."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from lerobot_adamanip.benchmark.declaration_fields import DECLARATION, DEMONSTRATIONS, METHOD, SCALE, TRIALS
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.datasets.collection_spec import DEFAULT_LATE_STARTS
from lerobot_adamanip.episode.options import POSES
from lerobot_adamanip.mechanisms import DEFAULT_MECHANISM_RULES
from lerobot_adamanip.util.errors import ConfigurationError, require_choice
from lerobot_adamanip.util.json_fields import Check, choice, table

PAPER_TABLE = Path(__file__).with_name("paper_table.toml")
"""The declaration that is used where no other is given."""
METHODS_GROUP = "lerobot_adamanip.benchmark_methods"
"""Entry points by which other packages declare methods: each is what a table ``[methods.NAME]`` would be."""


@dataclass(frozen=True, kw_only=True)
class Demonstrations:
    """A set of demonstrations, of each category; see `lerobot_adamanip.cli.collect.Collect`.

    Attributes:
        expert: ``adaptive`` or ``static``.
        trials: failed tries that the adaptive expert demonstrates before it changes its mind.
        late_starts: share of episodes that start where another hand has lost its grip.
        num_points: points per cloud, also in evaluations.
        image_size: side of the pictures [px], also in evaluations; 0 for demonstrations without any.
        poses: also in evaluations.
        mechanism_rules: also in evaluations.
    """

    expert: str = "adaptive"
    trials: int = 1
    late_starts: float = DEFAULT_LATE_STARTS
    num_points: int = schema.DEFAULT_NUM_POINTS
    image_size: int = 0
    poses: str = POSES[0]
    mechanism_rules: str = DEFAULT_MECHANISM_RULES


@dataclass(frozen=True, kw_only=True)
class Method:
    """A row of the table.

    Attributes:
        title: what tables call it.
        policy: ``--policy.type``.
        options: ``--policy.NAME=VALUE`` options that it is made with.
        demonstrations: name of the set that it is trained on; empty for a policy that needs no training.
        train: further options of ``lerobot-train``; they win over the scale's.
        evaluate: further options of ``lerobot-eval``, likewise.
        steps: of its training, by scale, where they are not the scale's.
        train_at: by scale, options of ``lerobot-train`` that win over ``train``.
        paper: what the paper calls it; empty if it is not in the paper.
        package: the distribution that declares it; empty for the declaration's own.
    """

    title: str
    policy: str
    options: tuple[str, ...] = ()
    demonstrations: str = ""
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
        save_every: steps between checkpoints; what is interrupted goes on from the last one. Decides no result.
        episodes: of an evaluation; ``environments`` run at once.
        device: of torch.
        poses: of all scenes; empty for those of each set of demonstrations.
        evaluate: options of ``lerobot-eval``; those of a method win.
        note: what its numbers say, for its report; ``beside_paper``: whether the paper's stand beside them there.
            Neither decides a result.
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
    """A method on demonstrations of more and more trials that fail, the paper's second table.

    Attributes:
        method: which one.
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
        """Returns a scale by its name; raises `ConfigurationError` if there is no such one."""
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
    curve = TrialsCurve(**TRIALS("trials", found["trials"])) if found["trials"] else None
    made = Declaration(
        reference=found["reference"],
        scales={name: _made(Scale, SCALE, f"scales.{name}", each) for name, each in found["scales"].items()},
        demonstrations={
            name: _made(Demonstrations, DEMONSTRATIONS, f"demonstrations.{name}", each)
            for name, each in found["demonstrations"].items()
        },
        methods={name: _made(Method, METHOD, f"methods.{name}", each) for name, each in found["methods"].items()},
        trials=curve,
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
        method = _made(Method, METHOD, point.name, dict(point.load()))
        _check_method(declaration, point.name, method)
    except Exception as error:  # whatever a package of somebody's does when it is imported
        raise ConfigurationError(
            f"The benchmark method {point.name!r} cannot be used.",
            got=f"{point.value} of {package}: {error}",
            allowed="a table like [methods.NAME], see docs/extending.md",
            hint=f"mend {package}, or uninstall it",
        ) from error
    return replace(method, package=package)


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
    _one_of("reference", made.reference, made.methods)
    for name, method in made.methods.items():
        _check_method(made, name, method)
    if (curve := made.trials) is not None:
        _one_of("trials.method", curve.method, made.methods)
        _one_of("trials.none", curve.none, made.demonstrations)
        _one_of(
            f"methods.{curve.method}.demonstrations", made.methods[curve.method].demonstrations, made.demonstrations
        )
        for scale in curve.scales:
            _one_of("trials.scales", scale, made.scales)


def _check_method(made: Declaration, name: str, method: Method) -> None:
    _one_of(f"methods.{name}.demonstrations", method.demonstrations, ("", *made.demonstrations))
    for scale in (*method.steps, *method.train_at):
        _one_of(f"methods.{name}.steps and train_at", scale, made.scales)


def _one_of(name: str, got: str, names: Mapping[str, Any] | Sequence[str]) -> None:
    choice(tuple(names))(name, got)
