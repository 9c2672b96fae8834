"""Options, episodes, seeds and folders of a collection."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.categories import ALL
from lerobot_adamanip.contract.control import ACTION_NAMES, STATES
from lerobot_adamanip.contract.memory import EVENTS, MEMORY, NO_MEMORY, memory_feature
from lerobot_adamanip.contract.seeds import SPLITS
from lerobot_adamanip.contract.sensing import EXACT
from lerobot_adamanip.datasets.output_folder import COLLECTING
from lerobot_adamanip.episode.options import DEFAULT_LATE_STARTS, EnvironmentOptions, check_late_starts, to_stored
from lerobot_adamanip.experts import EXPERT_KINDS, EXPERT_STRATEGIES
from lerobot_adamanip.util.errors import ConfigurationError, listed, require_choice

SPLIT = "train"
DEMO_SEED_START, DEMO_SEED_END = SPLITS[SPLIT]
"""Range of demonstration seeds; it does not overlap with evaluation seeds."""
LIMITS: Mapping[str, tuple[int, int]] = {
    "episodes_per_object": (1, 100_000), "trials": (1, 20), "seed": (0, 2**63 - 1),
}  # fmt: skip
MAX_OBJECTS, MAX_EPISODES = 5_000, 1_000_000


def episode_seed(seed: int, category: str, object_id: str, slot: int, attempt: int) -> int:
    """Returns an episode's seed, a hash of its place in the collection.

    It is independent of the expert and of the order of work. So adaptive and static collections of one seed have equal
    layouts and hidden states, and any number of workers gives the same data.
    """
    place = json.dumps([seed, category, object_id, slot, attempt]).encode()
    number = int.from_bytes(hashlib.sha256(place).digest()[:8], "big")
    return DEMO_SEED_START + number % (DEMO_SEED_END - DEMO_SEED_START)


@dataclass(frozen=True, order=True)
class EpisodeSpec:
    """One episode to record: number ``slot`` of an object."""

    slot: int
    object_id: str

    def __str__(self) -> str:
        return f"{self.object_id}, episode {self.slot}"

    @property
    def file_name(self) -> str:
        """Name of its episode file."""
        return f"{self.object_id}-{self.slot:05d}.safetensors"


@dataclass(frozen=True)
class CollectionSpec:
    """Options that decide the data of a collection; equal options give equal collections.

    Attributes:
        environment: options of the environments; its ``category`` is that of the first object. ``observe_images=None``
            counts as False, because a specification must not depend on the machine. In dense control, cameras and
            source of pictures are the chosen ones or the defaults, so that a specification names them.
        objects: ids of one or more categories, in the order of the dataset.
        expert: ``adaptive`` or ``static``.
        expert_strategy: see `lerobot_adamanip.experts.EXPERT_STRATEGIES`.
        episodes_per_object: number of successes to keep per object.
        trials: failed tries of a motion before the adaptive expert changes it (the paper's second table).
        seed: seed of the whole collection.
        late_starts: share of episodes that start from mid-task states, see `lerobot_adamanip.collection.late_starts`.
        keep_failed: whether to keep failed episodes, in a separate dataset.
        policy: hash of a policy that drives while the expert corrects it (`collection.corrections`); empty for
            demonstrations of the expert. Episodes of a policy are kept with and without success.
        expert_share: share of key frames that the expert drives; 1 for demonstrations.
        mistakes: share of key frames in which a mistake is executed, see `lerobot_adamanip.collection.mistakes`.
    """

    environment: EnvironmentOptions
    objects: tuple[str, ...]
    expert: str = "adaptive"
    expert_strategy: str = "paper"
    episodes_per_object: int = 20
    trials: int = 1
    seed: int = 0
    late_starts: float = DEFAULT_LATE_STARTS
    keep_failed: bool = False
    policy: str = ""
    expert_share: float = 1.0
    mistakes: float = 0.0

    def __post_init__(self) -> None:
        if self.environment.observe_images is None:
            object.__setattr__(self, "environment", self.environment.changed(observe_images=False))
        if self.environment.is_dense:
            chosen = {"cameras": self.environment.observed_cameras, "image_source": self.environment.images_from}
            object.__setattr__(self, "environment", self.environment.changed(**chosen))
        require_choice("expert", self.expert, EXPERT_KINDS)
        require_choice("expert strategy", self.expert_strategy, EXPERT_STRATEGIES)
        for name, (lowest, highest) in LIMITS.items():
            value = getattr(self, name)
            _require(lowest <= value <= highest, name, value, f"{lowest} ... {highest}", lowest)
        check_late_starts(self.late_starts)
        _require(0 <= self.expert_share <= 1, "expert_share", self.expert_share, "a share, 0 ... 1")
        alone = bool(self.policy) or self.expert_share == 1
        _require(alone, "expert_share", self.expert_share, "1 without a policy")
        _require(0 <= self.mistakes < 1, "mistakes", self.mistakes, "a share, 0 up to below 1", 0.2)
        alone = not self.mistakes or not (self.policy or self.expert == "static")
        _require(alone, "mistakes", self.mistakes, "0, or the adaptive expert without a policy", 0)
        _require(not (self.policy and self.expert == "static"), "expert", "static", "adaptive: it takes over")
        different = len(set(self.objects)) == len(self.objects)
        _require(0 < len(self.objects) <= MAX_OBJECTS and different, "objects", listed(self.objects), "ids, each once")
        count = len(self.objects) * self.episodes_per_object
        _require(count <= MAX_EPISODES, "number of episodes", count, f"at most {MAX_EPISODES}")
        for category in self.categories:
            self.environment_of(category)

    @property
    def categories(self) -> tuple[str, ...]:
        """Categories of the objects, in their order."""
        return tuple(dict.fromkeys(map(category_of, self.objects)))

    @property
    def category(self) -> str:
        """Category of all objects; ``all`` for several."""
        return self.categories[0] if len(self.categories) == 1 else ALL

    def environment_of(self, category: str) -> EnvironmentOptions:
        """Returns the options of the environment for a category's objects; raises `ConfigurationError`."""
        ids = ",".join(name for name in self.objects if category_of(name) == category)
        return self.environment.changed(category=category, objects=ids, split=SPLIT, seed_offset=0)

    def items(self) -> list[EpisodeSpec]:
        """Returns the episodes in dataset order: each object's first, then each second (any prefix is balanced)."""
        return [EpisodeSpec(slot, name) for slot in range(self.episodes_per_object) for name in self.objects]


def _require(holds: bool, name: str, got: object, allowed: str, advice: object = None) -> None:
    if not holds:
        hint = "adamanip collect -h" if advice is None else f"--{name.replace('_', '-')} {advice}"
        raise ConfigurationError(f"Wrong {name} of a collection.", got=got, allowed=allowed, hint=hint)


class CollectionPaths:
    """Folders of a collection: ``root`` when complete, the others beside it until then.

    Attributes:
        root: the finished dataset.
        manifest: manifest of the finished dataset.
        failed: the dataset of failed episodes.
        partial: folder of an unfinished collection.
        partial_manifest: its manifest.
        episodes: files of the episodes to keep.
        failed_episodes: files of failed episodes, where they are kept.
        attempts: attempts at items without an episode file.
        building, building_failed: the two datasets, while they are assembled.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.manifest = manifest_path(root)
        self.failed = root.with_name(root.name + "-failed")
        self.partial = root.with_name(root.name + COLLECTING)
        self.partial_manifest = self.partial / "collection.json"
        self.episodes = self.partial / "episodes"
        self.failed_episodes = self.partial / "failed"
        self.attempts = self.partial / "attempts"
        self.building = self.partial / "dataset"
        self.building_failed = self.partial / "dataset-failed"


def manifest_path(root: Path) -> Path:
    """Returns the path of a dataset's manifest."""
    return root / "meta" / "collection.json"


def environment_json(environment: EnvironmentOptions) -> dict[str, Any]:
    """Returns the environment options that manifests hold: those that decide the data, without local paths."""
    plain = environment.to_json()
    more = DENSE_FIELDS if environment.is_dense else tuple(name for name in OF_PICTURES if plain[name] is not None)
    chosen = tuple(name for name, default in OPTIONAL_FIELDS.items() if plain[name] != default)
    return to_stored({name: plain[name] for name in (*MANIFEST_FIELDS, *more, *chosen)})


def columns_of(environment: EnvironmentOptions) -> dict[str, dict[str, Any]]:
    """Returns the features of a dataset of these environments; ``observe_images`` is resolved."""
    cameras = environment.observed_cameras if environment.observe_images else ()
    memory = {MEMORY: memory_feature()} if environment.memory == EVENTS else {}
    if not environment.is_dense:
        return schema.dataset_features(environment.num_points, environment.image_size, cameras=cameras) | memory
    dense = schema.dense_features(
        ACTION_NAMES[environment.action],
        STATES[environment.state],
        image_size=environment.image_size,
        cameras=cameras,
        num_points=environment.num_points if environment.observe_cloud else None,
        has_effort=environment.observe_effort,
    )
    return dense | memory


MANIFEST_FIELDS = (
    "num_points", "image_size", "observe_images", "cloud_source", "poses", "mechanism_rules", "max_key_frames",
    "max_failed_tries", "hidden_overrides", "workspace",
)  # fmt: skip
"""Environment options in a manifest."""
OF_PICTURES = ("cameras", "image_source")
"""Environment options in a manifest of key frames if they are chosen."""
OPTIONAL_FIELDS = {"sensing": EXACT, "self_calibration": False, "hints": 0.0, "memory": NO_MEMORY}
"""Environment options in a manifest if they differ from these defaults."""
DENSE_FIELDS = ("control", "fps", "action", "state", "max_steps", "observe_cloud", "observe_effort", *OF_PICTURES)
"""More environment options in a manifest of dense control."""
