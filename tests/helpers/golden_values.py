"""Values that the simulation version and the data version decide: the golden values of ``tests/golden``.

Values that need no simulator and no sums over many numbers are equal on every Python and processor: they are hashes of
numbers rounded to 1e-6. Numbers that come out of a solver or of sums in parallel differ in their last digits: they are
kept as means and deviations, and compared within a tolerance.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import importlib.util
import json
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lerobot_adamanip.catalog import make_object, object_id
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.control import DENSE, KEYFRAME
from lerobot_adamanip.contract.seeds import (
    SPLITS,
    BalancedDraws,
    Stream,
    category_offset,
    episode_generator,
    retried_seed,
    scene_seed,
)
from lerobot_adamanip.contract.versions import DATA_VERSION, SIMULATION_VERSION
from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_adamanip.objects.base import Shape

TESTS = Path(__file__).resolve().parents[1]
GOLDEN = TESTS / "golden"
SEEDS = tuple(SPLITS["train"][0] + 1000 * number for number in range(3))
NUM_POINTS, _POINTS = 512, 8
"""Points of simulated and of fixed clouds."""
_STEP, _OFFSET = 1e-6, 0.37
"""Numbers are rounded to multiples of 1e-6, with an offset: halves of a step, as of 1/640, would round either way."""
_DIGITS = 4
"""Digits of numbers that are compared within a tolerance."""
Values = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Golden:
    """One file of golden values.

    Attributes:
        name: of the file in ``tests/golden``, without its ending.
        version_name, version: version that decides the values, and its present value.
        compute: name of value -> function that returns it, JSON-able.
        tolerance: largest difference of a number, relative to 1 or to a larger value.
    """

    name: str
    version_name: str
    version: int
    compute: Mapping[str, Callable[[], Any]]
    tolerance: float = 0.0

    @property
    def path(self) -> Path:
        """The file."""
        return GOLDEN / f"{self.name}.json"

    def stored(self) -> tuple[int, Values]:
        """Returns the stored version and values; (0, {}) without a file."""
        if not self.path.exists():
            return 0, {}
        content = json.loads(self.path.read_text(encoding="utf-8"))
        return content["version"], content["values"]

    def difference(self, name: str, value: Any) -> str:
        """Returns where a value differs from the stored one; empty if it does not."""
        return "".join(_differences(name, self.stored()[1].get(name), value, self.tolerance))[:500]

    def advice(self) -> str:
        """Returns what to do when a value differs."""
        return (
            f"behaviour changed: raise {self.version_name} in lerobot_adamanip/contract/versions.py, "
            "then run: python scripts/golden.py --write"
        )


def _differences(place: str, stored: Any, value: Any, tolerance: float) -> Iterable[str]:
    if isinstance(stored, dict) and isinstance(value, dict) and stored.keys() == value.keys():
        for name in stored:
            yield from _differences(f"{place}/{name}", stored[name], value[name], tolerance)
    elif isinstance(stored, list) and isinstance(value, list) and len(stored) == len(value):
        for number, pair in enumerate(zip(stored, value, strict=True)):
            yield from _differences(f"{place}/{number}", *pair, tolerance)
    elif isinstance(stored, float) and isinstance(value, float):
        if not abs(stored - value) <= tolerance * max(1.0, abs(stored)):
            yield f"{place}: {value:.6g}, not {stored:.6g}. "
    elif stored != value or type(stored) is not type(value):
        yield f"{place}: {value!r:.80}, not {stored!r:.80}. "


# Hashes -----------------------------------------------------------------------------------------------------------


def digest(value: object) -> str:
    """Returns a hash of nested data: dataclasses by their values, numbers rounded, mappings in order of names."""
    made = hashlib.sha256()
    for part in _parts(value):
        made.update(part + b"\n")
    return made.hexdigest()[:16]


def _parts(value: object) -> Iterable[bytes]:
    if isinstance(value, Shape):
        # The order of a convex hull's vertices and faces is its library's.
        vertices = np.zeros((0, 3)) if value.vertices is None else np.asarray(value.vertices, np.float64)
        yield np.unique(_rounded(vertices), axis=0).tobytes()
        named = {item.name: getattr(value, item.name) for item in dataclasses.fields(value)}
        faces = 0 if value.faces is None else len(value.faces)
        yield from _parts([faces, *(each for name, each in named.items() if name not in ("vertices", "faces"))])
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield from _parts([getattr(value, item.name) for item in dataclasses.fields(value)])
    elif isinstance(value, Mapping):
        for name in sorted(value):
            yield str(name).encode()
            yield from _parts(value[name])
    elif isinstance(value, str | bytes | bool | None):
        yield repr(value).encode()
    elif isinstance(value, list | tuple):
        yield f"{len(value)} values".encode()
        for each in value:
            yield from _parts(each)
    else:
        array = np.asarray(value)
        assert array.dtype.kind in "biuf", type(value)
        yield f"{array.shape}".encode() + _rounded(array.astype(np.float64)).tobytes()


def _rounded(array: ArrayLike) -> Any:
    return np.floor(np.asarray(array, np.float64) / _STEP + _OFFSET).astype("<i8")


def statistics(array: ArrayLike) -> Values:
    """Returns shape, mean and standard deviation of numbers (N, ...) over their first axis."""
    numbers = np.asarray(array, np.float64)
    numbers = numbers.reshape(len(numbers), -1)
    if numbers.shape[1] > 64:
        numbers = numbers.reshape(-1, 3)  # clouds
    mean, deviation = (np.round(each, _DIGITS).tolist() for each in (numbers.mean(axis=0), numbers.std(axis=0)))
    return {"shape": list(np.shape(array)), "mean": mean, "std": deviation}


# What needs no simulator ------------------------------------------------------------------------------------------


def _seeds() -> str:
    seeds = [scene_seed(seed, split) for seed in (0, 7, 10**6, 2**24 + 5, 2**40) for split in SPLITS]
    retried = [retried_seed(seed, split, 1) for seed in SEEDS for split in SPLITS]
    return digest([seeds, retried, [category_offset(each) for each in CATEGORIES]])


def _streams() -> str:
    drawn = [
        episode_generator(seed, stream, category).random(4)
        for seed in SEEDS
        for stream in list(Stream)[: Stream.SENSING]  # later ones decide nothing by default
        for category in CATEGORIES
    ]
    return digest(drawn)


def _objects(category: str) -> str:
    return digest([make_object(object_id(category, number)) for number in range(3)])


def _novel_objects(category: str) -> str:
    return digest(make_object(object_id(category, 0, novel=True)))


def _hidden(category: str) -> str:
    rules = [make_mechanism(make_object(object_id(category, 0)), each) for each in ("paper", "upstream", "hard")]
    return digest([each.hidden(each.draw(BalancedDraws(seed, category))) for each in rules for seed in SEEDS])


PLAIN: dict[str, Callable[[], Any]] = {
    "seeds": _seeds,
    "streams": _streams,
    **{f"objects/{each}": functools.partial(_objects, each) for each in CATEGORIES},
    **{f"novel objects/{each}": functools.partial(_novel_objects, each) for each in CATEGORIES},
    **{f"hidden/{each}": functools.partial(_hidden, each) for each in CATEGORIES},
}


# Rows and trainings -----------------------------------------------------------------------------------------------


def _rows() -> Values:
    """Rows, labels and statistics of one episode of five fixed key frames: a failed try, a turn and a pull."""
    import pyarrow.parquet as pq

    from lerobot_adamanip.collection.assemble import append_shards
    from lerobot_adamanip.datasets.shards import RecordedEpisode, write_shard
    from lerobot_adamanip.datasets.writing import create_dataset

    episode = RecordedEpisode(_recorder().columns(), {"task": "Open the safe."})
    with tempfile.TemporaryDirectory() as folder:
        root, shard = Path(folder) / "dataset", Path(folder) / "0.safetensors"
        write_shard(shard, episode)
        dataset = create_dataset(root, "local/golden", features=schema.dataset_features(_POINTS, cameras=()))
        append_shards(dataset, [shard], lambda done, total: None)
        rows = pq.read_table(root / "data/chunk-000/file-000.parquet").to_pydict()
        stats = json.loads((root / "meta/stats.json").read_text())
    return {"columns": {name: digest(values) for name, values in rows.items()}, "statistics": _flat(stats)}


def _recorder() -> Any:
    from lerobot_adamanip.contract.keyframes import Feedback, Goal, KeyFrameLabels, Outcome, Phase
    from lerobot_adamanip.contract.rotations import rotation_about, transform
    from lerobot_adamanip.episode.rollout import EpisodeRecorder, KeyFrame

    positions = iter(_ramp(len(schema.JOINT_NAMES), step) for step in range(9))
    made = EpisodeRecorder(lambda: next(positions))
    tries = ((-1, False), (0, True), (1, False), (0, False), (-1, False))
    for step, (tried, failed) in enumerate(tries):
        pose = transform((0.4 + 0.02 * step, 0.1, 0.5), rotation_about((0, 0, 1), 0.25 * step))
        outcome = Outcome.STALLED if failed else Outcome.REACHED
        labels = KeyFrameLabels(tried, failed, 0.1 * (tried >= 0 and not failed), trial=int(step > 1))
        goal, feedback = Goal(pose, float(step < 1), Phase.TRY), Feedback(pose, 0.2 * step, outcome)
        made.record(KeyFrame(_observation(step), goal, feedback, _observation(step + 1), step == 4, labels))
    return made


def _observation(step: int) -> Values:
    cloud = np.stack([_ramp(_POINTS, step + axis) for axis in range(3)], axis=1)
    return {"agent_pos": _ramp(schema.STATE_DIM, step), "effort": _ramp(schema.NUM_JOINTS, step), "point_cloud": cloud}


def _ramp(size: int, start: int) -> Any:
    return (0.125 * start + 0.03125 * np.arange(size)).astype(np.float32)


def _flat(stats: Values) -> Values:
    """Returns ``column/statistic`` -> its numbers, or their mean if they are many."""
    named = {f"{name}/{kind}": np.ravel(value) for name, each in stats.items() for kind, value in each.items()}
    few = {name: value if value.size <= 32 else value[:1] * 0 + value.mean() for name, value in named.items()}
    return {name: [float(each) for each in value] for name, value in few.items()}


@functools.cache
def _trained() -> tuple[Values, Values]:
    """A batch of ``dp3_adaptive`` of preset ``keyframe``, and losses and actions of four training steps on it."""
    import torch
    from toy_demos import record_toy, toy_world

    spec = importlib.util.spec_from_file_location("policy_fixtures", TESTS / "policies" / "conftest.py")
    assert spec is not None
    assert spec.loader is not None
    fixtures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fixtures)
    with tempfile.TemporaryDirectory() as folder, torch.random.fork_rng():
        root = record_toy(Path(folder) / "toy", [toy_world("bottle_000", seed) for seed in range(2)], "adaptive")
        torch.manual_seed(0)
        policy, before, _, dataset = fixtures.build_policy("dp3_adaptive", root, preset="keyframe")
        items = [dataset[index] for index in range(len(dataset))]
        batch = before(torch.utils.data.default_collate(items))
        window, labels, valid = policy.training_window(batch)
        batches = {"labels": statistics(labels), "are_real": statistics(valid)}
        batches |= {name: statistics(each) for name, each in _tensors(window)}
        optimizer, losses = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3), []
        for _ in range(4):
            optimizer.zero_grad()
            loss, _ = policy.forward(batch)
            loss.backward()
            optimizer.step()
            policy.update()
            losses.append(loss.item())
    return batches, {"losses": losses, "parameters": sum(each.numel() for each in policy.parameters())}


def _tensors(window: Any) -> Iterable[tuple[str, Any]]:
    named = window if isinstance(window, Mapping) else vars(window)
    for name, value in named.items():
        if hasattr(value, "numpy") and value.ndim:
            yield str(name), value.float()


DATA: dict[str, Callable[[], Any]] = {
    "rows": _rows,
    "batches": lambda: _trained()[0],
    "training": lambda: _trained()[1],
}


# What is simulated ------------------------------------------------------------------------------------------------


def _episode(category: str, number: int, control: str = KEYFRAME) -> Values:
    """An expert's episode on one object: the first observation, the record, and all rows."""
    from lerobot_adamanip.collection.record import EpisodeRequest, attempt_episode
    from lerobot_adamanip.datasets.collection_spec import CollectionSpec
    from lerobot_adamanip.episode.options import EnvironmentOptions
    from lerobot_adamanip.experts import make_expert
    from lerobot_env_adamanip.make_environment import make_environment

    name = object_id(category, number)
    sizes = {"num_points": NUM_POINTS, "observe_images": False, "observe_cloud": True}
    options = EnvironmentOptions(category, objects=name, control=control, **sizes)
    spec = CollectionSpec(options, objects=(name,))
    with contextlib.closing(make_environment(spec.environment_of(category))) as env:
        _, episode = attempt_episode(env, spec, make_expert, EpisodeRequest(name, SEEDS[number]))
    record = episode.record["episode_record"]
    cloud = episode.columns[schema.POINT_CLOUD]
    return {
        "reset": {
            "cloud": statistics(np.reshape(cloud[0], (-1, 3))),
            "state": _floats(episode.columns[schema.STATE][0]),
        },
        "record": {
            **{key: record[key] for key in ("success", "key_frames", "hidden_state", "try_sequence")},
            "joints": {key: float(value) for key, value in record["joints"].items()},
        },
        "rows": {key: statistics(values) for key, values in episode.columns.items() if key != schema.EXECUTED},
    }


def _floats(array: ArrayLike) -> list[float]:
    return [round(float(each), _DIGITS) for each in np.ravel(array)]


SIMULATED: dict[str, Callable[[], Any]] = {
    f"{category}/{number}": functools.partial(_episode, category, number)
    for category in CATEGORIES
    for number in range(len(SEEDS))
} | {f"{category}/{DENSE}": functools.partial(_episode, category, 0, DENSE) for category in ("bottle", "safe", "door")}

ALL = (
    Golden("plain", "SIMULATION_VERSION", SIMULATION_VERSION, PLAIN),
    Golden("data", "DATA_VERSION", DATA_VERSION, DATA, 1e-3),
    Golden("simulation", "SIMULATION_VERSION", SIMULATION_VERSION, SIMULATED, 2e-3),
)
