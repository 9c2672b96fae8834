"""Which commands a cell needs, and the keys by which cells share what they produce. Pure functions.

A key is a hash of the command that makes something, with what that command reads named by its own key, and of the code
that runs. Cells whose trainings have equal keys share one training; anything that decides a result changes its key.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from lerobot_adamanip.benchmark.cells import Cell
from lerobot_adamanip.benchmark.declaration import Declaration, Demonstrations, Method, Scale
from lerobot_adamanip.benchmark.training import last_checkpoint
from lerobot_adamanip.catalog import parse_object_selection
from lerobot_adamanip.evaluation.results import check_command

COLLECT, TRAIN, EVALUATE = "collect", "train", "evaluate"
FOLDERS: Mapping[str, str] = {COLLECT: "demonstrations", TRAIN: "trainings", EVALUATE: "evaluations"}
"""Kind of step -> folder of what such steps produce, relative to that of the benchmark, in which commands run."""
EPISODE_LOG = "episodes.jsonl"
TEST_SEED = 1000
"""Of an evaluation's first scene, and of a policy's draws in it: the same for all methods and trainings."""
NUMBERS = ("lerobot_adamanip.evaluation.metrics", "lerobot_adamanip.evaluation.log")
"""Modules that count an evaluation's episodes."""
_ATTEMPTS = 25
"""Of an episode of demonstrations: with six failed trials each, safes that take many key frames run out of time."""
_KEY = "{key}"
_COLLECTED = f"{FOLDERS[COLLECT]}/{_KEY}"
_SPELLED_IN_KEYS = {
    "--mechanism-rules": "--mechanism-preset", "--env.mechanism_rules": "--env.mechanism_preset",
}  # fmt: skip
"""Option -> its former name, by which keys go on to be made: a new name changes no result."""
_LENGTH = 16


@dataclass(frozen=True)
class Code:
    """Hashes of the code that decides results.

    Attributes:
        demonstrations: simulator, mechanisms, objects, experts and what records them.
        episodes: simulator, mechanisms and objects.
        policies: by method.
        numbers: what counts an evaluation's episodes.
    """

    demonstrations: str = ""
    episodes: str = ""
    policies: Mapping[str, str] = field(default_factory=dict)
    numbers: str = ""


@dataclass(frozen=True)
class Step:
    """A command and what it needs first.

    Attributes:
        kind: `COLLECT`, `TRAIN` or `EVALUATE`.
        key: of what it produces.
        command: as typed in the benchmark's folder.
        aside: further options, which decide nothing.
        needs: the step whose product it reads.
    """

    kind: str
    key: str
    command: tuple[str, ...]
    aside: tuple[str, ...] = ()
    needs: Step | None = None

    @property
    def product(self) -> str:
        """Folder of what it produces, relative to the benchmark's."""
        return f"{FOLDERS[self.kind]}/{self.key}"

    def chain(self) -> Iterator[Step]:
        """Yields the steps it needs, in order, and itself."""
        if self.needs is not None:
            yield from self.needs.chain()
        yield self


def plan(cell: Cell, declaration: Declaration, scale_name: str, code: Code) -> Step:
    """Returns the evaluation that makes a cell's result, with all it needs.

    Raises:
        ConfigurationError: an option holds a path of this machine, or the scale's objects are none.
    """
    scale, method = declaration.scale(scale_name), declaration.methods[cell.method]
    learnt = _demonstrations(cell, declaration)
    like = learnt or Demonstrations()
    like = replace(like, poses=scale.poses or like.poses)
    training = None
    if learnt is not None:
        collected = _collection(cell, like, scale, code)
        steps = method.steps.get(scale_name, scale.steps)
        last_word = (*method.train, *method.train_at.get(scale_name, ()))
        training = _training(cell, replace(method, train=last_word), replace(scale, steps=steps), collected, code)
    return _evaluation(cell, method, scale, code, like=like, training=training)


def options_key(cell: Cell, declaration: Declaration, scale: str) -> str:
    """Returns a key of the commands alone, whatever the code: whether a result is of what is declared now."""
    return plan(cell, declaration, scale, Code()).key


def _demonstrations(cell: Cell, declaration: Declaration) -> Demonstrations | None:
    name, curve = declaration.methods[cell.method].demonstrations, declaration.trials
    if cell.trials == 0 and curve is not None:
        return declaration.demonstrations[curve.none]
    if not name:
        return None
    found = declaration.demonstrations[name]
    return found if cell.trials is None else replace(found, trials=cell.trials)


def _collection(cell: Cell, wanted: Demonstrations, scale: Scale, code: Code) -> Step:
    objects = len(parse_object_selection(cell.category, scale.objects))
    # Pictures and trials only where they are: equal demonstrations shall have equal commands.
    pictures = (f"--image-size={wanted.image_size}",) if wanted.image_size else ("--no-images",)
    trials = (f"--trials={wanted.trials}",) if wanted.expert == "adaptive" else ()
    command = (
        "adamanip",
        "collect",
        f"--category={cell.category}",
        f"--objects={scale.objects}",
        f"--episodes-per-object={math.ceil(scale.demonstrations / objects)}",
        f"--expert={wanted.expert}",
        *trials,
        f"--late-starts={wanted.late_starts:g}",
        f"--num-points={wanted.num_points}",
        *pictures,
        f"--poses={wanted.poses}",
        f"--mechanism-rules={wanted.mechanism_rules}",
        _COLLECTED,
    )
    # Attempts of an episode end with the first success, so that a larger bound changes no dataset that is ever made.
    # So does saying that pictures are wanted: where none can be taken, the step fails at once.
    required = ("--images",) if wanted.image_size else ()
    return _step(COLLECT, command, code.demonstrations, aside=(f"--max-attempts={_ATTEMPTS}", *required))


def _training(cell: Cell, method: Method, scale: Scale, collected: Step, code: Code) -> Step:
    command = _with_options(
        "lerobot-train",
        f"--policy.type={method.policy}",
        *method.options,
        f"--policy.device={scale.device}",
        "--policy.push_to_hub=false",
        f"--dataset.repo_id=local/{collected.key}",
        f"--dataset.root={collected.product}",
        f"--batch_size={scale.batch_size}",
        f"--steps={scale.steps}",
        "--num_workers=0",
        f"--seed={cell.seed}",
        f"--output_dir={FOLDERS[TRAIN]}/{_KEY}",
        *method.train,
    )
    aside = (f"--save_freq={scale.save_every}", f"--log_freq={max(1, scale.steps // 20)}")
    return _step(TRAIN, command, code.policies.get(cell.method, ""), aside, collected)


def _evaluation(
    cell: Cell, method: Method, scale: Scale, code: Code, *, like: Demonstrations, training: Step | None
) -> Step:
    """Returns the evaluation of a policy that is trained, or needs no training, in scenes ``like`` demonstrations."""
    made = (f"--policy.type={method.policy}", *method.options)
    trained = () if training is None else (f"--policy.path={last_checkpoint(training.product)}",)
    pictures = (f"--env.image_size={like.image_size}",) if like.image_size else ()
    product = f"{FOLDERS[EVALUATE]}/{_KEY}"
    command = _with_options(
        "lerobot-eval",
        *(trained or made),
        f"--policy.device={scale.device}",
        f"--env.type=adamanip_{cell.category}",
        f"--env.objects={scale.objects if cell.objects == 'seen' else cell.objects}",
        "--env.split=test",
        f"--env.num_points={like.num_points}",
        *pictures,
        f"--env.poses={like.poses}",
        f"--env.mechanism_rules={like.mechanism_rules}",
        f"--env.episode_log={product}/{EPISODE_LOG}",
        f"--eval.n_episodes={scale.episodes}",
        f"--eval.batch_size={scale.environments}",
        f"--seed={TEST_SEED}",
        f"--output_dir={product}",
        *scale.evaluate,
        *method.evaluate,
    )
    # A policy that is not trained has its code told here, for it has no training whose key would tell it.
    policy = "" if training else code.policies.get(cell.method, "")
    told = f"{code.episodes} {code.numbers} {policy}".strip()
    # A policy that looks at pictures has been trained with them; without, evaluating is faster, and the same.
    named = any(word.startswith("--env.observe_images=") for word in command)
    observed = () if named else (f"--env.observe_images={'true' if like.image_size else 'false'}",)
    return _step(EVALUATE, command, told, aside=observed, needs=training)


def _step(kind: str, command: Iterable[str], code: str, aside: tuple[str, ...] = (), needs: Step | None = None) -> Step:
    template = list(command)
    check_command(" ".join(template))  # now, not when hours later a result is written
    decides = json.dumps({"command": [_spelled_in_key(word) for word in template], "code": code}).encode()
    key = hashlib.sha256(decides).hexdigest()[:_LENGTH]
    return Step(kind, key, tuple(word.replace(_KEY, key) for word in template), aside, needs)


def _spelled_in_key(word: str) -> str:
    if word == _COLLECTED:
        return f"--root={word}"
    name, equals, value = word.partition("=")
    return f"{_SPELLED_IN_KEYS.get(name, name)}{equals}{value}"


def option(command: Iterable[str], name: str) -> str:
    """Returns the value of the option ``--NAME=VALUE`` of a command that has it."""
    (value,) = (word.partition("=")[2] for word in command if word.partition("=")[0] == name)
    return value


def _with_options(command: str, *options: str) -> list[str]:
    """Returns a command whose every option is there once; a later one of a name wins."""
    return [command, *{option.partition("=")[0]: option for option in options}.values()]
