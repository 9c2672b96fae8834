"""Declaration of a benchmark: methods, their demonstrations, and scales. Read from TOML, with every field checked.

Installed packages can add methods to it, by an entry point.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Annotated, Any

from lerobot_adamanip.benchmark.paper_rates import SUCCESS
from lerobot_adamanip.catalog import FOR_TESTS
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.control import ACTION_NAMES, CONTROLS, DENSE, EE_DELTA, KEYFRAME, POSE, STATES
from lerobot_adamanip.contract.memory import MEMORIES, NO_MEMORY
from lerobot_adamanip.contract.sensing import EXACT
from lerobot_adamanip.datasets.collection_spec import LIMITS
from lerobot_adamanip.episode.options import DEFAULT_LATE_STARTS, IMAGE_SIZES, POSES
from lerobot_adamanip.evaluation.results import NAME
from lerobot_adamanip.experts import EXPERT_KINDS, EXPERT_STRATEGIES
from lerobot_adamanip.mechanisms import DEFAULT_MECHANISM_RULES, MECHANISM_RULES
from lerobot_adamanip.util.errors import ConfigurationError, require_choice
from lerobot_adamanip.util.json_fields import (
    choice,
    flag,
    integer,
    listing,
    mapping,
    number,
    record,
    text,
)

PAPER_TABLE = Path(__file__).with_name("paper_table.toml")
"""Default declaration."""
OBJECT_SPLITS = ("seen", "unseen", "novel")
METHODS_GROUP = "lerobot_adamanip.benchmark_methods"
"""Entry point group for methods of other packages; each one loads the content of a table ``[methods.NAME]``."""
_OPTIONAL_NAME = text(r"|[a-z][a-z0-9_]{0,39}", "a name of small letters, digits and _, or an empty text")
_CHECKPOINT = text(
    r"|[\w-]{1,96}/[\w.{}-]{1,96}", "USER/NAME of a checkpoint on the Hub; {category} may be a part of it"
)
_REVISION = text(r"|(?!main$)\w[\w.-]{0,63}", "a commit (40 hex digits) or a tag of the checkpoint, not main")
TITLE = text(r"[^\r\n|*`<>]{1,80}", "a line of plain text")
_COUNT = integer(1, 10**8)
_OBJECTS = text(r"[\w:,]{1,400}", "objects, in the form of `adamanip collect --objects`")
_CATEGORIES = listing(choice(tuple(CATEGORIES)), 1, len(CATEGORIES))
_SPLITS = listing(choice(OBJECT_SPLITS), 1, len(OBJECT_SPLITS))
GROUPS = (
    "dataset", "env", "eval", "job", "optimizer", "peft", "policy", "reward_model", "sample_weighting", "scheduler",
    "wandb",
)  # fmt: skip
"""LeRobot's groups of options. The value of a whole group, ``--env={...}``, would override all of ``--env.NAME``."""
_REFUSED = rf"(?:output_dir|config_path|policy\.type|{'|'.join(GROUPS)})=|[\w.]*(?:discover_packages_path|_to_hub)="
_ALLOWED = rf"--(?!{_REFUSED})"
"""Start of an option that sets no group or type, chooses no folder, imports no package and publishes nothing."""
_FOREIGN = (
    "--policy.path=", "--policy.pretrained_path=", "--policy.pretrained_revision=", "--dataset.root=",
    "--dataset.repo_id=", "--dataset.revision=", "--reward_model.path=",
)  # fmt: skip
"""Starts of the options that replace the weights or the data of the benchmark's own steps."""
_VALUE = r"=(?!\W*include|.*!include)[^\r\n`]{0,400}"  # LeRobot would read the value from the included file
_OPTIONS = listing(
    text(rf"{_ALLOWED}[a-z][\w.-]*{_VALUE}", "an option --NAME=VALUE of no group, file, folder, package or push"), 0, 60
)
_POLICY_OPTIONS = listing(text(rf"{_ALLOWED}policy\.[a-z][\w.]*{_VALUE}", "an option --policy.NAME=VALUE"), 0, 60)


@dataclass(frozen=True, kw_only=True)
class Demonstrations:
    """A set of demonstrations of each category; fields as in `lerobot_adamanip.cli.collect.Collect`.

    All but the expert's fields and ``mistakes`` apply to evaluations too; ``image_size`` is 0 for no images.
    ``action``, ``state`` and ``cloud`` are of dense control at 10 Hz.
    """

    expert: Annotated[str, choice(EXPERT_KINDS)] = "adaptive"
    expert_strategy: Annotated[str, choice(EXPERT_STRATEGIES)] = EXPERT_STRATEGIES[0]
    trials: Annotated[int, integer(*LIMITS["trials"])] = 1
    late_starts: Annotated[float, number(0, 1)] = DEFAULT_LATE_STARTS
    mistakes: Annotated[float, number(0, 0.99)] = 0.0
    num_points: Annotated[int, integer(1, 16_384)] = schema.DEFAULT_NUM_POINTS
    image_size: Annotated[int, integer(0, IMAGE_SIZES[1])] = 0
    poses: Annotated[str, choice(POSES)] = POSES[0]
    mechanism_rules: Annotated[str, choice(tuple(MECHANISM_RULES))] = DEFAULT_MECHANISM_RULES
    control: Annotated[str, choice(CONTROLS)] = KEYFRAME
    action: Annotated[str, choice(tuple(ACTION_NAMES))] = EE_DELTA
    state: Annotated[str, choice(tuple(STATES))] = POSE
    cloud: Annotated[bool, flag] = False
    memory: Annotated[str, choice(MEMORIES)] = NO_MEMORY
    sensing: Annotated[str, text(r"[\w.,=]{1,200}", "a level or parts, as of `--env.sensing`")] = EXACT

    @property
    def is_dense(self) -> bool:
        """Whether rows are of dense control."""
        return self.control == DENSE


@dataclass(frozen=True, kw_only=True)
class Round:
    """A round of corrections (DAgger): the policy acts, the expert corrects it, and training uses all data so far.

    Attributes:
        corrections: number of corrected episodes per category.
        steps: training steps.
        start: initial weights: ``new``, or those ``trained`` in the round before.
    """

    corrections: Annotated[int, _COUNT]
    steps: Annotated[int, _COUNT]
    start: Annotated[str, choice(("new", "trained"))] = "new"


@dataclass(frozen=True, kw_only=True)
class Method:
    """A row of the table: a policy or an expert.

    Attributes:
        title: name in tables.
        policy: policy type, the value of ``--policy.type``; empty for an expert.
        expert: options of `adamanip expert`, instead of a policy.
        options: ``--policy.NAME=VALUE`` options of the policy.
        demonstrations: name of the training set; empty for a policy without training.
        checkpoint: trained policy on the Hub, ``{category}`` stands for the cell's. It is not trained further; then
            ``demonstrations`` says what it observes.
        revision: commit or tag of the checkpoint, which needs one.
        rounds: correction rounds after the first training.
        data_of: method whose demonstrations and corrections of all categories are the training set: one policy for all.
        train: additional options of ``lerobot-train``; they override the scale's.
        evaluate: additional options of ``lerobot-eval``; they override the scale's.
        steps: training steps by scale, where they differ from the scale's.
        train_at: scale or category -> options of ``lerobot-train`` that override ``train``.
        scales: scales that have the method; empty for all.
        paper: name in the paper; empty if the paper does not have the method.
        learns_from: for the leaderboard, a line about data and teachers that the declaration does not show.
        package: distribution that declares it; empty for the declaration itself.
    """

    title: Annotated[str, TITLE]
    policy: Annotated[str, _OPTIONAL_NAME] = ""
    expert: Annotated[tuple[str, ...], _OPTIONS] = ()
    options: Annotated[tuple[str, ...], _POLICY_OPTIONS] = ()
    demonstrations: Annotated[str, _OPTIONAL_NAME] = ""
    checkpoint: Annotated[str, _CHECKPOINT] = ""
    revision: Annotated[str, _REVISION] = ""
    rounds: Annotated[tuple[Round, ...], listing(record(Round), 0, 20)] = ()
    data_of: Annotated[str, _OPTIONAL_NAME] = ""
    train: Annotated[tuple[str, ...], _OPTIONS] = ()
    evaluate: Annotated[tuple[str, ...], _OPTIONS] = ()
    steps: Annotated[Mapping[str, int], mapping(NAME, _COUNT, 20)] = field(default_factory=dict)
    train_at: Annotated[Mapping[str, tuple[str, ...]], mapping(NAME, _OPTIONS, 20)] = field(default_factory=dict)
    scales: Annotated[tuple[str, ...], listing(NAME, 0, 20)] = ()
    paper: Annotated[str, choice(("", *SUCCESS))] = ""
    learns_from: Annotated[str, text(r"[^\r\n|*`<>]{0,120}", "a line of plain text")] = ""
    package: str = ""

    @property
    def is_trained(self) -> bool:
        """Whether the method learns from data here."""
        return bool(self.demonstrations or self.data_of) and not self.checkpoint


@dataclass(frozen=True, kw_only=True)
class Scale:
    """Size of a benchmark run.

    Attributes:
        categories, splits, seeds: the cells; ``splits`` of objects, ``seeds`` of trainings with their demonstrations.
        objects: objects of the demonstrations and of the split ``seen``.
        objects_at: category -> objects, where they differ.
        reports: whether the splits ``unseen`` and ``novel`` are the objects that are kept for reported numbers.
        demonstrations: episodes per category, or per object with ``demonstrations_per_object``.
        steps, batch_size: steps and batch size of each training.
        save_every: steps between checkpoints; an interrupted training resumes from the last one. Changes no result.
        episodes: episodes per evaluation; ``environments`` of them run in parallel.
        device: PyTorch device.
        poses, mechanism_rules: in all scenes; empty to use those of each set of demonstrations.
        hints: share of episodes, demonstrations and evaluations, whose instruction says what is hidden.
        held_out: groups of categories; for a cell of one of them, a method with ``data_of`` learns from all categories
            but those of its group. All trained methods of such a scale need ``data_of``.
        shown: number of demonstrations of the cell's own category, on which that policy is trained further for
            ``shown_steps`` steps.
        evaluate: options of ``lerobot-eval``; a method's options override them.
        note: one sentence for the report. Changes no result.
        beside_paper: whether the report shows the paper's numbers. Changes no result.
    """

    objects: Annotated[str, _OBJECTS]
    demonstrations: Annotated[int, _COUNT]
    steps: Annotated[int, _COUNT]
    batch_size: Annotated[int, _COUNT]
    save_every: Annotated[int, _COUNT]
    episodes: Annotated[int, _COUNT]
    environments: Annotated[int, _COUNT] = 2
    device: Annotated[str, text(r"[a-z]{1,10}(:\d{1,2})?", "a PyTorch device")] = "cpu"
    poses: Annotated[str, choice(("", *POSES))] = ""
    mechanism_rules: Annotated[str, choice(("", *MECHANISM_RULES))] = ""
    hints: Annotated[float, number(0, 1)] = 0.0
    held_out: Annotated[tuple[tuple[str, ...], ...], listing(_CATEGORIES, 0, len(CATEGORIES))] = ()
    shown: Annotated[int, integer(0, 10_000)] = 0
    shown_steps: Annotated[int, integer(0, 10_000_000)] = 0
    evaluate: Annotated[tuple[str, ...], _OPTIONS] = ()
    categories: Annotated[tuple[str, ...], _CATEGORIES] = tuple(CATEGORIES)
    splits: Annotated[tuple[str, ...], _SPLITS] = ("seen", "unseen")
    seeds: Annotated[tuple[int, ...], listing(integer(0, 2**31 - 1), 1, 100)] = (1000,)
    demonstrations_per_object: Annotated[bool, flag] = False
    reports: Annotated[bool, flag] = False
    objects_at: Annotated[Mapping[str, str], mapping(choice(tuple(CATEGORIES)), _OBJECTS, 20)] = field(
        default_factory=dict
    )
    note: Annotated[str, text(r"[^\r\n|*`<>]{0,300}", "a line of plain text")] = ""
    beside_paper: Annotated[bool, flag] = False

    def objects_of(self, category: str) -> str:
        """Returns the objects of a category."""
        return self.objects_at.get(category, self.objects)

    def tested_objects(self, category: str, split: str) -> str:
        """Returns the objects of a category on which a cell of a split is evaluated."""
        return self.objects_of(category) if split == "seen" else f"{split}{FOR_TESTS if self.reports else ''}"

    def trained_categories(self, category: str) -> tuple[str, ...]:
        """Returns the categories that a method with ``data_of`` learns from for a cell of ``category``."""
        held_out = {name for group in self.held_out if category in group for name in group}
        return tuple(name for name in (CATEGORIES if self.held_out else self.categories) if name not in held_out)


@dataclass(frozen=True, kw_only=True)
class Effect:
    """Effect of a change: methods with and without it, compared in the same scenes of ``categories`` (none: all)."""

    title: Annotated[str, TITLE]
    method: Annotated[str, NAME]
    without: Annotated[str, NAME]
    categories: Annotated[tuple[str, ...], listing(choice(tuple(CATEGORIES)), 0, len(CATEGORIES))] = ()


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """A benchmark.

    Attributes:
        reference: method that all others are compared with.
        effects: changes whose effect the report shows.
        scales, demonstrations, methods: by name, in the order of the declaration.
    """

    reference: Annotated[str, NAME]
    scales: Annotated[Mapping[str, Scale], mapping(NAME, record(Scale), 20)]
    demonstrations: Annotated[Mapping[str, Demonstrations], mapping(NAME, record(Demonstrations), 60)]
    methods: Annotated[Mapping[str, Method], mapping(NAME, record(Method), 200)]
    effects: Annotated[tuple[Effect, ...], listing(record(Effect), 0, 40)] = ()

    def scale(self, name: str) -> Scale:
        """Returns a scale by name; raises `ConfigurationError` if it does not exist."""
        return self.scales[require_choice("scale", name, self.scales)]

    def methods_of(self, scale: str) -> dict[str, Method]:
        """Returns the methods of a scale, name -> method."""
        return {name: method for name, method in self.methods.items() if scale in (method.scales or (scale,))}


def read_declaration(path: Path = PAPER_TABLE) -> Declaration:
    """Reads a declaration without the methods of other packages; raises `ConfigurationError` if it is invalid."""
    try:
        return parse_declaration(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            "Not a declaration of a benchmark.",
            got=f"{path}: {error}",
            allowed="see docs/benchmark.md",
            hint=str(PAPER_TABLE),
        ) from error


def parse_declaration(content: Mapping[str, Any]) -> Declaration:
    """Returns the declaration in decoded TOML; raises ValueError that names the invalid field.

    A method's field ``like`` names a method above it, whose fields are its defaults, except ``title`` and ``paper``.
    """
    if isinstance(methods := content.get("methods"), Mapping):
        content = {**content, "methods": _with_defaults(methods)}
    declaration = record(Declaration)("the declaration", content)
    _require("reference", declaration.reference, declaration.methods)
    for name, method in declaration.methods.items():
        _check_method(declaration, name, method)
    for name, scale in declaration.scales.items():
        if scale.held_out and (own := [key for key, one in declaration.methods_of(name).items() if one.demonstrations]):
            raise ValueError(f"scales.{name} has held_out, but methods.{own[0]} has no data_of: it sees every category")
        if 0 in scale.seeds[1:]:
            raise ValueError(f"scales.{name}.seeds has 0 after the first, whose demonstrations are those of seed 0 too")
        if foreign := [one for one in scale.evaluate if one.startswith(_FOREIGN)]:
            raise ValueError(f"scales.{name}.evaluate has {foreign[0]}, the weights or data of a method")
        if scale.shown and not scale.held_out:
            raise ValueError(f"scales.{name}.shown needs held_out")
        if bool(scale.shown) != bool(scale.shown_steps):
            raise ValueError(f"scales.{name} needs both shown and shown_steps, or none of them")
    for effect in declaration.effects:
        _require("effects.method", effect.method, declaration.methods)
        _require("effects.without", effect.without, declaration.methods)
    return declaration


def _with_defaults(methods: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the tables of methods with the fields of those that they are ``like``."""
    merged: dict[str, Any] = {}
    for name, own in methods.items():
        merged[name] = own
        if isinstance(own, Mapping) and "like" in own:
            tables = [other for other, one in merged.items() if isinstance(one, Mapping)]
            _require(f"methods.{name}.like", own["like"], [other for other in tables if other != name])
            fields = {**merged[own["like"]], "paper": "", **own}
            left_out = {"like"} if "title" in own else {"like", "title"}
            merged[name] = {key: value for key, value in fields.items() if key not in left_out}
    return merged


def _check_method(declaration: Declaration, name: str, method: Method) -> None:
    """Raises ValueError if a method names what the declaration lacks, or contradicts itself."""
    _require(f"methods.{name}.demonstrations", method.demonstrations, ("", *declaration.demonstrations))
    if bool(method.policy) == bool(method.expert) or (method.expert and (method.demonstrations or method.data_of)):
        raise ValueError(f"methods.{name} needs a policy, or an expert without demonstrations")
    training = ("expert", "rounds", "data_of", "options", "train")
    if method.checkpoint and (unused := [field_name for field_name in training if getattr(method, field_name)]):
        raise ValueError(f"methods.{name} has a checkpoint, which is not trained, and {unused[0]}; evaluate is allowed")
    if bool(method.checkpoint) != bool(method.revision):
        raise ValueError(f"methods.{name} needs both checkpoint and revision, or none of them")
    options = (*method.options, *method.train, *method.evaluate, *itertools.chain(*method.train_at.values()))
    if (foreign := [one for one in options if one.startswith(_FOREIGN)]) and not method.learns_from:
        raise ValueError(f"methods.{name} has {foreign[0]} and no learns_from that says what these weights or data are")
    if method.rounds and not method.demonstrations:
        raise ValueError(f"methods.{name}.rounds need demonstrations, and the method has none")
    with_data = [other for other, one in declaration.methods.items() if one.demonstrations]
    _require(f"methods.{name}.data_of", method.data_of, ("", *with_data))
    if method.data_of and method.demonstrations:
        raise ValueError(f"methods.{name} has data_of another method and demonstrations of its own")
    for field_name in ("steps", "scales"):
        for scale in getattr(method, field_name):
            _require(f"methods.{name}.{field_name}", scale, declaration.scales)
    for where in method.train_at:
        _require(f"methods.{name}.train_at", where, (*declaration.scales, *CATEGORIES))


def _require(name: str, value: str, names: Iterable[str]) -> None:
    choice(tuple(names))(name, value)


def with_packages(declaration: Declaration) -> Declaration:
    """Returns a declaration with the methods of installed packages added; raises `ConfigurationError`."""
    points = sorted(entry_points(group=METHODS_GROUP))
    added = {point.name: _load_method(point, declaration) for point in points}
    return replace(declaration, methods={**declaration.methods, **added})


def _load_method(point: EntryPoint, declaration: Declaration) -> Method:
    package = point.dist.name if point.dist is not None else point.module
    try:
        NAME("the name of its entry point", point.name)
        if point.name in declaration.methods:
            raise ValueError("the declaration has a method of that name")
        method = record(Method)(point.name, point.load())
        _check_method(declaration, point.name, method)
    except Exception as error:  # importing another package may raise any exception
        raise ConfigurationError(
            f"The benchmark method {point.name!r} cannot be used.",
            got=f"{point.value} of {package}: {error}",
            allowed="a table like [methods.NAME], see docs/extending_policy.md",
            hint=f"repair {package}, or uninstall it",
        ) from error
    return replace(method, package=package)
