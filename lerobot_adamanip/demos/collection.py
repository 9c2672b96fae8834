"""What a collection is: its options, its work items, their seeds, and the folders it lives in."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from lerobot_adamanip import schema
from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.categories import ALL
from lerobot_adamanip.demos.shards import write_atomically
from lerobot_adamanip.errors import ConfigurationError, DatasetError, require_choice
from lerobot_adamanip.experts import EXPERT_KINDS

DEMO_SEED_START = 2**24
"""Demonstration seeds lie in [2^24, 2^31); evaluation uses seeds below a million, so the two never meet."""
DEMO_SEED_END = 2**31
ENV_FACTORY = "lerobot_env_adamanip.factory:make_keyframe_env"
EXPERT_FACTORY = "lerobot_adamanip.experts:make_expert"


def episode_seed(seed: int, category: str, object_id: str, slot: int, attempt: int) -> int:
    """Returns an episode's seed, a hash of its place in the collection.

    It depends on neither the expert nor the order of work: an adaptive and a static collection of one seed meet the
    same layouts and hidden states, and any number of workers, interrupted or not, gives the same data.
    """
    place = json.dumps([seed, category, object_id, slot, attempt]).encode()
    number = int.from_bytes(hashlib.sha256(place).digest()[:8], "big")
    return DEMO_SEED_START + number % (DEMO_SEED_END - DEMO_SEED_START)


@dataclass(frozen=True, order=True)
class EpisodeSpec:
    """One episode to be recorded: the ``slot``-th of an object."""

    slot: int
    object_id: str

    @property
    def file_name(self) -> str:
        """Name of its episode file."""
        return f"{self.object_id}-{self.slot:05d}.safetensors"


@dataclass(frozen=True)
class CollectionSpec:
    """Everything that decides which data a collection holds. Two collections of equal options are equal.

    Attributes:
        category: of object, or ``all`` for objects of several.
        objects: ids, in the order of the dataset.
        expert: ``adaptive`` or ``static``.
        episodes_per_object: successes to keep of each object.
        num_points: points per cloud.
        trials: adaptive trials the expert may demonstrate (the paper's second table).
        seed: of the whole collection.
        image_size: height and width of the front image [px].
        env_options: passed on to the environment.
        expert_options: passed on to the expert.
        env_factory: ``module:function``, called as (category, num_points, image_size=, **env_options).
        expert_factory: ``module:function``, called as (category, kind, annotations, trials=, generator=, hidden=,
            **expert_options).
    """

    category: str
    objects: tuple[str, ...]
    expert: str = "adaptive"
    episodes_per_object: int = 20
    num_points: int = schema.DEFAULT_NUM_POINTS
    trials: int = 1
    seed: int = 0
    image_size: int = schema.IMAGE_SIZE
    env_options: dict[str, Any] = field(default_factory=dict)
    expert_options: dict[str, Any] = field(default_factory=dict)
    env_factory: str = ENV_FACTORY
    expert_factory: str = EXPERT_FACTORY

    def __post_init__(self) -> None:
        require_choice("expert", self.expert, EXPERT_KINDS)
        for name in ("episodes_per_object", "num_points", "trials", "image_size"):
            if getattr(self, name) < 1:
                raise ConfigurationError(
                    f"{name} is too small.", got=getattr(self, name), allowed="1 or more", hint=f"{name} = 1"
                )
        if not self.objects or len(set(self.objects)) != len(self.objects):
            raise ConfigurationError(
                "Objects must be given, each once.",
                got=self.objects,
                allowed="different object ids",
                hint="--objects 0:4",
            )

    def category_of(self, object_id: str) -> str:
        """Returns the category of one of the objects."""
        return category_of(object_id) if self.category == ALL else self.category

    def items(self) -> list[EpisodeSpec]:
        """Returns the episodes in dataset order: the first of every object, then the second: any prefix is balanced."""
        return [EpisodeSpec(slot, name) for slot in range(self.episodes_per_object) for name in self.objects]

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary."""
        plain: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return plain

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> CollectionSpec:
        """Reads `to_json` back."""
        return cls(**{**content, "objects": tuple(content["objects"])})


@dataclass(frozen=True)
class CollectionPaths:
    """Where a collection lives: ``root`` once complete; beside it what is not."""

    root: Path

    @property
    def partial(self) -> Path:
        """Episodes recorded so far."""
        return self.root.with_name(self.root.name + ".partial")

    @property
    def episodes(self) -> Path:
        """RecordedEpisode files."""
        return self.partial / "episodes"

    @property
    def assembling(self) -> Path:
        """The dataset under construction."""
        return self.root.with_name(self.root.name + ".assembling")

    @property
    def partial_manifest(self) -> Path:
        """Options of an unfinished collection."""
        return self.partial / "collection.json"

    @property
    def manifest(self) -> Path:
        """Options of a finished one."""
        return self.root / "meta" / "collection.json"

    def clean(self) -> None:
        """Removes what only an unfinished collection needs."""
        for folder in (self.partial, self.assembling):
            shutil.rmtree(folder, ignore_errors=True)


def read_manifest(path: Path) -> CollectionSpec:
    """Reads options back; raises `DatasetError` if the file is damaged."""
    try:
        return CollectionSpec.from_json(json.loads(path.read_text()))
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise DatasetError(
            "Cannot read the options of a collection.",
            got=f"{path}: {error}",
            allowed="the file `adamanip collect` wrote",
            hint="another --root",
        ) from error


def write_manifest(path: Path, options: CollectionSpec) -> None:
    """Writes options, durably."""
    write_atomically(path, (json.dumps(options.to_json(), indent=2, sort_keys=True) + "\n").encode())


def require_same(stored: CollectionSpec, wanted: CollectionSpec, where: Path) -> None:
    """Raises `DatasetError` naming every option in which a collection on disk differs from the one asked for."""
    old, new = stored.to_json(), wanted.to_json()
    different = [name for name in new if old[name] != new[name]]
    if different:
        raise DatasetError(
            f"{where} holds a collection made with other options: {', '.join(different)}.",
            got="; ".join(f"{name} = {new[name]!r}" for name in different),
            allowed="; ".join(f"{name} = {old[name]!r}" for name in different),
            hint="the same options, or another --root (a dataset does not grow: collect the rest elsewhere)",
        )
