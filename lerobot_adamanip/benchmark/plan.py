"""Plan of a benchmark: its cells, their commands, and the cache keys by which they share products. Pure functions.

A cell is one training of a method, evaluated on one split of objects of one category. A key hashes a step's command,
the keys of what it reads, and the versions that decide its result. Equal keys run once. Installed versions of other
packages are not in it: a report says where they differ.
"""

from __future__ import annotations

import hashlib
import json
import math
import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from lerobot_adamanip.benchmark.declaration import OBJECT_SPLITS, Declaration, Demonstrations, Method, Scale
from lerobot_adamanip.catalog import SEEN_COUNTS, parse_object_selection
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.versions import DATA, DATA_VERSION, SIMULATION, SIMULATION_VERSION
from lerobot_adamanip.evaluation.results import EVALUATE, LOGGED, ResultFile, check_command, command_options
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError, nearest, require_choice

COLLECT, CORRECT, MERGE, TRAIN = "collect", "correct", "merge", "train"
FOLDERS: Mapping[str, str] = {
    **dict.fromkeys((COLLECT, CORRECT, MERGE), "demonstrations"),
    TRAIN: "trainings",
    EVALUATE: "evaluations",
}
"""Kind of step -> folder of its products, relative to the benchmark's folder."""
EPISODE_LOG = "episodes.jsonl"
REVISION = "--policy.pretrained_revision"
"""Option of `lerobot-eval`: revision of the weights of a checkpoint on the Hub. LeRobot reads the rest from main."""
VIDEO_SIZE = 128
"""Side [px] of `lerobot-eval`'s videos if no policy sees them. At 256 px they take most of an evaluation's time."""
TEST_SEED = 1000
"""Seed of an evaluation's first scene and of the policy's sampling; equal for all methods and trainings."""
_ATTEMPTS = 25
"""Attempts per demonstration: with six failed trials, long episodes of safes exceed the time limit."""
_NEXT_ROUND = 100_000
"""Added to the seed of each further round of corrections: two rounds could share an episode that the expert drove."""
_KEY = "{key}"
_COLLECTED = f"{FOLDERS[COLLECT]}/{_KEY}"
_LENGTH = 16
ENV_TYPE, TYPE_PREFIX = "--env.type", "adamanip_"
_EXPERT_OPTIONS = {
    ENV_TYPE: "--category",
    "--seed": "--seed",
    "--eval.n_episodes": "--episodes",
    **{
        f"--env.{name}": f"--{name.replace('_', '-')}"
        for name in (
            "objects", "split", "poses", "mechanism_rules", "episode_length", "max_failed_tries", "episode_log",
            "repeats", "sensing", "hints",
        )
    },
}  # fmt: skip
"""Option of `lerobot-eval` -> option of `adamanip expert`, which has no others of an environment."""
_CHOSEN = (
    "episode_log", "observe_", "num_points", "image_", "camera", "cloud_source", "control", "fps", "action", "state",
    "memory", "self_calibration", "other_categories",
)  # fmt: skip
CHOSEN = tuple(f"--env.{start}" for start in _CHOSEN)
"""Starts of the options of an environment that a method may choose: they do not change its scenes."""
_NOT_OF_EXPERTS = (
    *CHOSEN, "--policy.", "--eval.batch_size", "--eval.use_async_envs", "--env.render_backend", "--env.run_label",
    "--output_dir",
)  # fmt: skip
"""Starts of the options of `lerobot-eval` that do not change an expert's episodes: observations, device, batches."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One result of a benchmark.

    Attributes:
        method: name of the method.
        category: category of the objects.
        objects: split of the evaluated objects.
        seed: seed of the training and of its demonstrations.
    """

    method: str
    category: str
    objects: str
    seed: int

    @property
    def name(self) -> str:
        """A file name: ``dp3_adaptive-safe-seen-1000``."""
        return f"{self.method}-{self.category}-{self.objects}-{self.seed}"


def cell_of(result: ResultFile) -> Cell:
    """Returns the cell of a benchmark's result; raises `DatasetError` for another result."""
    if result.run is None:
        raise DatasetError(
            "A result of no benchmark is among those of one.",
            got=f"{result.title}: {result.command}",
            allowed="files that `adamanip benchmark` has written into cells/",
            hint="move the file elsewhere",
        )
    row = result.rows[0]
    return Cell(method=result.run.method, category=row.category, objects=row.objects, seed=result.run.seed)


def all_cells(declaration: Declaration, scale: str) -> list[Cell]:
    """Returns the cells of a scale, category by category, so that an interrupted run has complete categories.

    A method without training has one cell, of the first seed.
    """
    chosen = declaration.scale(scale)
    return [
        Cell(method=name, category=category, objects=objects, seed=seed)
        for seed in chosen.seeds
        for category in chosen.categories
        for name, method in declaration.methods_of(scale).items()
        for objects in chosen.splits
        if method.is_trained or seed == chosen.seeds[0]
    ]


def select_cells(
    declaration: Declaration,
    scale: str,
    *,
    methods: tuple[str, ...] = (),
    categories: tuple[str, ...] = (),
    splits: tuple[str, ...] = (),
    seeds: tuple[int, ...] = (),
) -> list[Cell]:
    """Returns the selected cells of a scale; an empty filter selects all.

    Raises:
        ConfigurationError: a value is unknown, or no selected cell has it.
    """
    for what, names, known in (
        ("method", methods, tuple(declaration.methods)),
        ("category", categories, tuple(CATEGORIES)),
        ("split of objects", splits, OBJECT_SPLITS),
    ):
        for name in names:
            require_choice(what, name, known)
    filters = {"method": methods, "category": categories, "objects": splits, "seed": seeds}
    every = all_cells(declaration, scale)
    cells = [cell for cell in every if all(getattr(cell, name) in own for name, own in filters.items() if own)]
    for part in (every, cells):
        possible = {name: dict.fromkeys(getattr(cell, name) for cell in part) for name in filters}
        lacking = {name: [one for one in own if one not in possible[name]] for name, own in filters.items()}
        if any(lacking.values()):
            raise ConfigurationError(
                f"The scale {scale!r} has no such cells{'' if part is every else ' in this selection'}.",
                got=_listed(lacking),
                allowed=_listed({name: dict.fromkeys(getattr(cell, name) for cell in every) for name in filters}),
                hint="adamanip benchmark --list; methods without training have the first seed alone",
            )
    return cells


def _listed(names: Mapping[str, Iterable[object]]) -> str:
    titles = {"method": "methods", "category": "categories", "objects": "splits", "seed": "seeds"}
    return "; ".join(f"{titles[what]} {', '.join(map(str, values))}" for what, values in names.items() if values)


def last_checkpoint(folder: Path | str) -> Path:
    """Returns the folder of a training's last weights; it may not exist yet."""
    return Path(folder) / "checkpoints" / "last" / "pretrained_model"


@dataclass(frozen=True)
class KeyVersions:
    """Versions in the cache keys.

    Attributes:
        simulation, data: see `lerobot_adamanip.contract.versions`.
        policies: method -> name and version of its policy's package, if that is another project's.
    """

    simulation: int = SIMULATION_VERSION
    data: int = DATA_VERSION
    policies: Mapping[str, str] = field(default_factory=dict)

    @property
    def episodes(self) -> str:
        """Versions that decide the episodes of a given policy."""
        return f"{SIMULATION} {self.simulation}"

    def policy(self, method: str) -> str:
        """Returns the versions that decide how a method's policy learns and acts."""
        return f"{DATA} {self.data} {self.policies.get(method, '')}".strip()


@dataclass(frozen=True)
class Step:
    """A command and the steps that it depends on.

    Attributes:
        kind: `COLLECT`, `CORRECT`, `MERGE`, `TRAIN` or `EVALUATE`.
        key: cache key of the product.
        command: as typed in the benchmark's folder.
        non_key_options: options that do not enter the cache key.
        needs: steps whose products the command reads.
    """

    kind: str
    key: str
    command: tuple[str, ...]
    non_key_options: tuple[str, ...] = ()
    needs: tuple[Step, ...] = ()

    @property
    def product(self) -> str:
        """Returns the output folder, relative to the benchmark's."""
        return f"{FOLDERS[self.kind]}/{self.key}"

    def chain(self) -> Iterator[Step]:
        """Yields the steps it depends on, in order and each once, then the step itself."""
        yield from dict.fromkeys(step for need in self.needs for step in need.chain())
        yield self


def named_steps(last: Step) -> dict[str, Step]:
    """Returns name -> step of a chain, in order: ``collect``, ``train``; repeated kinds are ``train_2`` and so on."""
    steps: dict[str, Step] = {}
    for step in last.chain():
        before = sum(other.kind == step.kind for other in steps.values())
        steps[f"{step.kind}_{before + 1}" if before else step.kind] = step
    return steps


def plan(cell: Cell, declaration: Declaration, scale_name: str, versions: KeyVersions) -> Step:
    """Returns the evaluation step of a cell, with all steps that it depends on.

    Raises:
        ConfigurationError: an option contains a path of this machine, or the scale's objects do not exist.
    """
    scale, method = declaration.scale(scale_name), declaration.methods[cell.method]
    demonstrations = declaration.methods[method.data_of or cell.method].demonstrations
    like = declaration.demonstrations[demonstrations] if demonstrations else Demonstrations()
    rules = scale.mechanism_rules or like.mechanism_rules
    like = replace(like, poses=scale.poses or like.poses, mechanism_rules=rules)
    training = _learning(cell, declaration, scale_name, versions, like=like)[1] if method.is_trained else None
    return _evaluation(cell, method, scale, versions, like=like, training=training)


def options_key(cell: Cell, declaration: Declaration, scale: str) -> str:
    """Returns a key of the commands alone, to compare a result with the present declaration."""
    return plan(cell, declaration, scale, KeyVersions(0, 0)).key


def _learning(
    cell: Cell, declaration: Declaration, scale_name: str, versions: KeyVersions, *, like: Demonstrations
) -> tuple[Step, Step]:
    """Returns the dataset that a method trains on last, and that training."""
    scale, method = declaration.scale(scale_name), declaration.methods[cell.method]
    overriding = (option for where in (scale_name, cell.category) for option in method.train_at.get(where, ()))
    method = replace(method, train=(*method.train, *overriding))
    if method.data_of:
        names = scale.trained_categories(cell.category)
        others = [replace(cell, method=method.data_of, category=category) for category in names]
        parts = [_learning(other, declaration, scale_name, versions, like=like)[0] for other in others]
        data = _merge(tuple(parts))
    else:
        data = _collection(cell, like, scale, versions)
    training = _training(cell, method, scale, data, versions, steps=method.steps.get(scale_name, scale.steps))
    for number, round_ in enumerate(method.rounds):
        scenes = replace(cell, seed=cell.seed + _NEXT_ROUND * number)
        corrected = _correction(scenes, like, scale, versions, episodes=round_.corrections, training=training)
        data = _merge((data, corrected))
        start = training if round_.start == "trained" else None
        training = _training(cell, method, scale, data, versions, steps=round_.steps, start=start)
    if scale.shown and method.data_of:
        objects = f"0:{min(scale.shown, SEEN_COUNTS[cell.category])}"
        few = replace(
            scale, objects=objects, objects_at={}, demonstrations=scale.shown, demonstrations_per_object=False
        )
        data = _collection(cell, like, few, versions)
        training = _training(cell, method, scale, data, versions, steps=scale.shown_steps, start=training)
    return data, training


def _collection(cell: Cell, data: Demonstrations, scale: Scale, versions: KeyVersions) -> Step:
    expert = (f"--expert={data.expert}", *_changed(data, "expert_strategy"))
    trials = (f"--trials={data.trials}",) if data.expert == "adaptive" else ()  # others would have unequal keys
    mistakes = (f"--mistakes={data.mistakes:g}",) if data.mistakes else ()
    how = (*expert, *trials, f"--late-starts={data.late_starts:g}", *mistakes)
    shared_by = 1 if scale.demonstrations_per_object else _objects(cell, scale)
    per_object = math.ceil(scale.demonstrations / shared_by)
    return _recording(COLLECT, cell, data, scale, versions, per_object=per_object, how=how)


def _correction(
    cell: Cell, data: Demonstrations, scale: Scale, versions: KeyVersions, *, episodes: int, training: Step
) -> Step:
    chosen = _changed(data, "expert_strategy", "trials", "late_starts")
    how = (f"--policy={last_checkpoint(training.product)}", *chosen)
    per_object = math.ceil(episodes / _objects(cell, scale))
    return _recording(CORRECT, cell, data, scale, versions, per_object=per_object, how=how, needs=(training,))


def _objects(cell: Cell, scale: Scale) -> int:
    return len(parse_object_selection(cell.category, scale.objects_of(cell.category)))


def _recording(
    kind: str,
    cell: Cell,
    data: Demonstrations,
    scale: Scale,
    versions: KeyVersions,
    *,
    per_object: int,
    how: tuple[str, ...],
    needs: tuple[Step, ...] = (),
) -> Step:
    """Returns a recording; each training seed has its own scenes, and the first one those of `adamanip collect`."""
    command = (
        "adamanip",
        "collect",
        f"--category={cell.category}",
        f"--objects={scale.objects_of(cell.category)}",
        f"--episodes-per-object={per_object}",
        *((f"--seed={cell.seed}",) if cell.seed != scale.seeds[0] else ()),
        *how,
        f"--num-points={data.num_points}",
        f"--image-size={data.image_size}" if data.image_size else "--no-images",
        f"--poses={data.poses}",
        f"--mechanism-rules={data.mechanism_rules}",
        *(_dense_options(data, "--") if data.is_dense else ()),
        *(("--cloud",) if data.is_dense and data.cloud else ()),
        *_changed(data, "memory", "sensing"),
        *((f"--hints={scale.hints:g}",) if scale.hints else ()),
        _COLLECTED,
    )
    # Attempts end with the first success, so a higher limit changes no dataset.
    decides = f"{versions.episodes}, {DATA} {versions.data}"
    return _step(kind, command, decides, (f"--max-attempts={_ATTEMPTS}",), needs)


def _dense_options(data: Demonstrations, prefix: str) -> tuple[str, ...]:
    return tuple(f"{prefix}{name}={getattr(data, name)}" for name in ("control", "action", "state"))


def _changed(data: Demonstrations, *names: str, prefix: str = "--") -> tuple[str, ...]:
    """Returns options that are not the default, so that keys of former results hold."""
    values = {name: getattr(data, name) for name in names if getattr(data, name) != getattr(Demonstrations(), name)}
    texts = {name: value if isinstance(value, str) else f"{value:g}" for name, value in values.items()}
    return tuple(f"{prefix}{name.replace('_', '-')}={text}" for name, text in texts.items())


def _merge(parts: tuple[Step, ...]) -> Step:
    command = ("adamanip", "merge", *(part.product for part in parts), f"--out={FOLDERS[MERGE]}/{_KEY}")
    return _step(MERGE, command, "", needs=parts)


def _training(
    cell: Cell,
    method: Method,
    scale: Scale,
    data: Step,
    versions: KeyVersions,
    *,
    steps: int,
    start: Step | None = None,
) -> Step:
    chosen = {option.partition("=")[0] for option in (*method.options, *method.train)}
    begin: tuple[str, ...] = () if "--policy.path" in chosen else (f"--policy.type={method.policy}",)
    if start is not None:
        begin = (f"--policy.path={last_checkpoint(start.product)}",)
    # LeRobot would read an existing folder, whatever the name.
    is_own = not chosen & {"--dataset.repo_id", "--dataset.revision"}
    command = _command(
        "lerobot-train",
        *begin,
        *method.options,
        f"--policy.device={scale.device}",
        "--policy.push_to_hub=false",
        f"--dataset.repo_id=local/{data.key}",
        *((f"--dataset.root={data.product}",) if is_own else ()),
        f"--batch_size={scale.batch_size}",
        f"--steps={steps}",
        "--num_workers=0",
        f"--seed={cell.seed}",
        f"--output_dir={FOLDERS[TRAIN]}/{_KEY}",
        *method.train,
        *(begin if start is not None else ()),  # wins over the method's
    )
    length = int(command_options(shlex.join(command))["--steps"])  # a method's options win
    logging = (f"--save_freq={scale.save_every}", f"--log_freq={max(1, length // LOGGED)}")
    needs = (data,) if start is None else (data, start)
    return _step(TRAIN, command, versions.policy(cell.method), logging, needs)


def _evaluation(
    cell: Cell, method: Method, scale: Scale, versions: KeyVersions, *, like: Demonstrations, training: Step | None
) -> Step:
    """Returns the evaluation of a policy, trained or not, or of an expert, in the scenes of demonstrations ``like``."""
    untrained = (f"--policy.type={method.policy}", *method.options)
    path = method.checkpoint.replace("{category}", cell.category)
    path = path if training is None else str(last_checkpoint(training.product))
    pictures = (f"--env.image_size={like.image_size}",) if like.image_size else ()
    cloud = f"--env.observe_cloud={'true' if like.cloud else 'false'}"
    dense = (*_dense_options(like, "--env."), cloud) if like.is_dense else ()
    product = f"{FOLDERS[EVALUATE]}/{_KEY}"
    command = _command(
        "lerobot-eval",
        *((f"--policy.path={path}",) if path else untrained),
        *((f"{REVISION}={method.revision}",) if method.revision else ()),
        f"--policy.device={scale.device}",
        f"--env.type=adamanip_{cell.category}",
        f"--env.objects={scale.tested_objects(cell.category, cell.objects)}",
        "--env.split=test",
        f"--env.num_points={like.num_points}",
        *pictures,
        *dense,
        *_changed(like, "memory", "sensing", prefix="--env."),
        f"--env.poses={like.poses}",
        f"--env.mechanism_rules={like.mechanism_rules}",
        *((f"--env.hints={scale.hints:g}",) if scale.hints else ()),
        f"--env.episode_log={product}/{EPISODE_LOG}",
        f"--eval.n_episodes={scale.episodes}",
        f"--eval.batch_size={scale.environments}",
        f"--seed={TEST_SEED}",
        f"--output_dir={product}",
        *scale.evaluate,
        *method.evaluate,
    )
    # An untrained policy has no training key, so its versions enter here.
    decides = versions.episodes if training else f"{versions.episodes}, {versions.policy(cell.method)}"
    if method.expert:
        return _step(EVALUATE, _expert_command(method.expert, command[1:]), decides)
    # A policy that uses images was trained with them. For others, evaluation without images is equal and faster.
    named = any(word.startswith("--env.observe_images=") for word in command)
    unseen = ("--env.observe_images=false", f"--env.image_size={VIDEO_SIZE}")
    observed = () if named else ("--env.observe_images=true",) if like.image_size else unseen
    return _step(EVALUATE, command, decides, observed, () if training is None else (training,))


def _command(command: str, *options: str) -> list[str]:
    """Returns a command with each option once; the last value of an option wins."""
    return [command, *{option.partition("=")[0]: option for option in options}.values()]


def _expert_command(expert: Iterable[str], evaluation: Iterable[str]) -> list[str]:
    """Returns the command that evaluates an expert as ``evaluation``, options of `lerobot-eval`, does a policy.

    Raises:
        ConfigurationError: an option decides episodes, and `adamanip expert` does not have it.
    """
    words = ["adamanip", "expert", *expert]
    for option in evaluation:
        name, _, value = option.partition("=")
        if name in _EXPERT_OPTIONS:
            words.append(f"{_EXPERT_OPTIONS[name]}={value.removeprefix(TYPE_PREFIX)}")
        elif not name.startswith(_NOT_OF_EXPERTS):
            known = [other for other in _EXPERT_OPTIONS if other.startswith("--env.")]
            raise ConfigurationError(
                "An option of an evaluation is none of `adamanip expert`.",
                got=option,
                allowed="the options of `adamanip expert --help`, by their names in lerobot-eval",
                hint=nearest(name, known) or "evaluate of the policies' methods instead of the scale's",
            )
    return words


def evaluation_options(command: str) -> dict[str, str]:
    """Returns the options of an evaluation, also an expert's, by their names in `lerobot-eval`, name -> value."""
    options = command_options(command)
    if shlex.split(command)[:2] != ["adamanip", "expert"]:
        return options
    names = {name: options[own] for name, own in _EXPERT_OPTIONS.items() if own in options}
    return {**names, ENV_TYPE: f"{TYPE_PREFIX}{names[ENV_TYPE]}"}


def _step(
    kind: str,
    command: Iterable[str],
    versions: str,
    non_key_options: tuple[str, ...] = (),
    needs: tuple[Step, ...] = (),
) -> Step:
    template = list(command)
    check_command(" ".join(template))  # fail now rather than hours later, when the result is written
    decides = json.dumps({"command": template, "versions": versions}).encode()
    key = hashlib.sha256(decides).hexdigest()[:_LENGTH]
    return Step(kind, key, tuple(word.replace(_KEY, key) for word in template), non_key_options, needs)
