"""Manifest ``meta/collection.json``: how a dataset was collected. It may be untrusted, so every field is checked.

It contains no code and no path. For external assets it has a hash of each object's content.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot_adamanip.assets import AssetSource, is_asset_id
from lerobot_adamanip.contract.cameras import CAMERAS
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.contract.control import ACTION_NAMES, DENSE, RATES, STATES
from lerobot_adamanip.contract.memory import EVENTS, TEXT
from lerobot_adamanip.contract.pointcloud import FURTHEST_CORNER_M, MAX_POINTS, MIN_POINTS, Workspace
from lerobot_adamanip.contract.sensing import SENSING_TEXT
from lerobot_adamanip.datasets.collection_spec import (
    LIMITS,
    MAX_EPISODES,
    MAX_OBJECTS,
    OF_PICTURES,
    CollectionPaths,
    CollectionSpec,
    environment_json,
)
from lerobot_adamanip.datasets.episode import HIDDEN_STATE, check_object_id
from lerobot_adamanip.episode.options import (
    BEST,
    CLOUD_SOURCES,
    IMAGE_SIZES,
    IMAGE_SOURCES,
    KEY_FRAMES,
    MAX_FAILED_TRIES,
    POSES,
    STEPS,
    EnvironmentOptions,
    from_stored,
    to_stored,
)
from lerobot_adamanip.experts import EXPERT_KINDS, EXPERT_STRATEGIES
from lerobot_adamanip.mechanisms import MECHANISM_RULES
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError, DatasetError, listed
from lerobot_adamanip.util.json_fields import (
    Check,
    choice,
    either,
    flag,
    integer,
    listing,
    mapping,
    number,
    optional,
    read,
    table,
    text,
)

FORMAT = 3
"""Version of the manifest and of the columns beside it."""
_WORD = text(r"[\w .:+-]{1,80}", "a short word")


@dataclass(frozen=True)
class AttemptCounts:
    """Numbers of attempted episodes.

    Attributes:
        kept: attempts in the dataset.
        attempted: all attempts.
        given_up: episodes without a successful attempt.
    """

    kept: int
    attempted: int
    given_up: int


@dataclass(frozen=True)
class Manifest:
    """Content of ``meta/collection.json``.

    Attributes:
        spec: the options.
        versions: name -> version of the software, from the environment's ``software_versions``.
        external_assets: object id -> hash of its folder's content; empty for generated objects.
        attempts: counts of a finished collection.
        processors: CPU models that recorded a finished collection. On different ones, the last digits may differ.
    """

    spec: CollectionSpec
    versions: Mapping[str, str] = field(default_factory=dict)
    external_assets: Mapping[str, str] = field(default_factory=dict)
    attempts: AttemptCounts | None = None
    processors: tuple[str, ...] = ()

    @classmethod
    def of(cls, spec: CollectionSpec, versions: Mapping[str, str]) -> Manifest:
        """Returns the manifest of a new collection."""
        assets = spec.environment.assets
        hashes = {} if assets is None else {name: asset_hash(assets, name) for name in spec.objects}
        return cls(spec, dict(versions), hashes)

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary."""
        spec = self.spec
        absent = ("environment",) if spec.mistakes else ("environment", "mistakes")
        return {
            "format": FORMAT,
            "category": spec.category,
            "collection": {
                **to_stored({name: value for name, value in vars(spec).items() if name not in absent}),
                "objects": list(spec.objects),
                "environment": environment_json(spec.environment),
            },
            "versions": dict(self.versions),
            "external_assets": dict(self.external_assets),
            "attempts": None if self.attempts is None else vars(self.attempts),
            "processors": list(self.processors),
        }


def asset_hash(assets: str | Path, object_id: str) -> str:
    """Returns a hash of all files of an external object."""
    digest, folder = hashlib.sha256(), AssetSource(Path(assets)).folder(object_id)
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            digest.update(f"{path.relative_to(folder).as_posix()} {content}\n".encode())
    return digest.hexdigest()[:32]


def write_manifest(path: Path, manifest: Manifest) -> None:
    """Writes a manifest durably."""
    files.write_atomically(path, (json.dumps(manifest.to_json(), indent=2, sort_keys=True) + "\n").encode())


def read_manifest(path: Path, assets: str | Path | None = None) -> Manifest:
    """Reads a manifest; ``assets`` is the folder of external assets, if they were used.

    Raises:
        DatasetError: it is missing or damaged, a field is invalid, or ``assets`` does not fit.
    """
    try:
        return _manifest(table(_MANIFEST)("the manifest", read(path)), None if assets is None else str(assets))
    except (OSError, ValueError, OverflowError) as error:
        if isinstance(error, AdaManipError) and not isinstance(error, ConfigurationError):
            raise
        raise DatasetError(
            "Cannot read the manifest of a collection.",
            got=f"{path}: {error}",
            allowed="the file `adamanip collect` wrote",
            hint="another folder",
        ) from error


def stored_images(paths: CollectionPaths) -> bool | None:
    """Returns whether a collection, finished or not, has images; None if there is no collection."""
    for path in (paths.manifest, paths.partial_manifest):
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            return bool(read(path)["collection"]["environment"]["observe_images"])
    return None


def require_same(stored: Manifest, wanted: Manifest, where: Path) -> None:
    """Raises `DatasetError` that names all options, objects and versions in which two manifests differ."""
    for what, hint, old, new in (
        (
            "holds a collection made with other options",
            "the same options, or another folder (a dataset does not grow: collect the rest elsewhere)",
            _flat(stored),
            _flat(wanted),
        ),
        (
            "was collected with other external assets",
            "the --assets of before, or another folder",
            stored.external_assets,
            wanted.external_assets,
        ),
        (
            "was recorded with other versions",
            "install the versions of before, or use another folder: episodes of both do not go together",
            stored.versions,
            wanted.versions,
        ),
    ):
        if parts := differing_parts(old, new):
            raise DatasetError(
                f"{where} {what}: {', '.join(parts)} differ.",
                got="; ".join(f"{name} = {_shown(new.get(name))}" for name in parts),
                allowed="; ".join(f"{name} = {_shown(old.get(name))}" for name in parts),
                hint=hint,
            )


def are_same_versions(of_episode: object, of_collection: Mapping[str, str]) -> bool:
    """Returns whether an episode has the versions of a collection; its ``cpu`` may be any."""
    return isinstance(of_episode, Mapping) and {**of_episode, "cpu": ""} == {**of_collection, "cpu": ""}


def differing_parts(one: Mapping[str, Any], other: Mapping[str, Any]) -> tuple[str, ...]:
    """Returns the names whose values differ."""
    return tuple(name for name in sorted({*one, *other}) if one.get(name) != other.get(name))


def _flat(manifest: Manifest) -> dict[str, Any]:
    whole = manifest.to_json()
    content = whole["collection"]
    environment = content.pop("environment")
    return {"category": whole["category"], **from_stored(content), **from_stored(environment)}


def _shown(value: object) -> str:
    return listed(value) if isinstance(value, list | tuple) else repr(value)


_VERSIONS = mapping(_WORD, text(r"[^\x00-\x1f\x7f|`<>]{1,400}", "a version"), 64)
_CORNER = listing(number(-FURTHEST_CORNER_M, FURTHEST_CORNER_M), 3, 3)
_ENVIRONMENT: Mapping[str, Check] = {
    "num_points": integer(MIN_POINTS, MAX_POINTS),
    "image_size": integer(*IMAGE_SIZES),
    "observe_images": flag,
    "cloud_source": choice(CLOUD_SOURCES),
    "poses": choice(POSES),
    "mechanism_preset": choice(MECHANISM_RULES),
    "max_key_frames": integer(*KEY_FRAMES),
    "max_failed_tries": optional(either(choice((BEST,)), integer(0, MAX_FAILED_TRIES))),
    "hidden_overrides": HIDDEN_STATE,
    "workspace": table({"lower": _CORNER, "upper": _CORNER}),
}
_DENSE: Mapping[str, Check] = {
    "control": choice((DENSE,)),
    "fps": integer(min(RATES), max(RATES)),
    "action": choice(tuple(ACTION_NAMES)),
    "state": choice(tuple(STATES)),
    "max_steps": optional(integer(*STEPS)),
    "observe_cloud": flag,
    "observe_effort": flag,
    "cameras": optional(listing(choice(tuple(CAMERAS)), 1, len(CAMERAS))),
    "image_source": optional(choice(IMAGE_SOURCES)),
}
_OPTIONAL: Mapping[str, Check] = {
    "sensing": text(SENSING_TEXT, "a level of sensing with its parts"),
    "self_calibration": flag,
    "hints": number(0.0, 1.0),
    "memory": choice((EVENTS, TEXT)),
}
"""Options that are there if they differ from their defaults."""


def _environment(name: str, value: Any) -> Any:
    """Checks the options of the environments: those of dense control are there for it alone."""
    fields = value if isinstance(value, Mapping) else {}
    names = _DENSE if "control" in fields else [key for key in OF_PICTURES if key in fields]
    chosen = {key: check for key, check in _OPTIONAL.items() if key in fields}
    return table({**_ENVIRONMENT, **{key: _DENSE[key] for key in names}, **chosen})(name, value)


_COLLECTION: Mapping[str, Check] = {
    "objects": listing(check_object_id, 1, MAX_OBJECTS),
    "environment": _environment,
    "expert": choice(EXPERT_KINDS),
    "expert_preset": choice(EXPERT_STRATEGIES),
    "late_starts": number(0.0, 1.0),
    "keep_failed": flag,
    "policy": text(r"([0-9a-f]{32})?", "a hash, or nothing"),
    "expert_share": number(0.0, 1.0),
    **{name: integer(*limits) for name, limits in LIMITS.items()},
}


def _collection(name: str, value: Any) -> Any:
    """Checks the options of a collection; mistakes are there for demonstrations that have some."""
    has_mistakes = isinstance(value, Mapping) and "mistakes" in value
    return table({**_COLLECTION, **({"mistakes": number(0.0, 1.0)} if has_mistakes else {})})(name, value)


_COUNT = integer(0, 1000 * MAX_EPISODES)
_MANIFEST: Mapping[str, Check] = {
    "format": integer(FORMAT, FORMAT),
    "category": choice((*CATEGORIES, ALL)),
    "collection": _collection,
    "versions": _VERSIONS,
    "external_assets": mapping(check_object_id, text(r"[0-9a-f]{32}", "a hash"), MAX_OBJECTS),
    "attempts": optional(table(dict.fromkeys(("kept", "attempted", "given_up"), _COUNT))),
    "processors": listing(text(r"[^\x00-\x1f\x7f|`<>]{1,200}", "a CPU model"), 0, 1000),
}


def _manifest(content: dict[str, Any], assets: str | None) -> Manifest:
    collection, hashes = dict(content["collection"]), content["external_assets"]
    external = [name for name in collection["objects"] if is_asset_id(name)]
    if sorted(external) != sorted(hashes) or (hashes and len(external) < len(collection["objects"])):
        raise ValueError("external_assets does not list the objects")
    if bool(hashes) != (assets is not None):
        raise DatasetError(
            "This collection used external assets." if hashes else "This collection used generated objects.",
            got=f"--assets {assets}",
            allowed="their folder" if hashes else "no folder",
            hint="--assets DIR" if hashes else "leave --assets out",
        )
    options = from_stored(collection.pop("environment"))
    workspace = Workspace(**options.pop("workspace"))
    first = collection["objects"][0].partition(":")[0] if hashes else collection["objects"][0].rpartition("_")[0]
    environment = EnvironmentOptions(
        first, objects=collection["objects"][0], assets=assets, workspace=workspace, **options
    )
    spec = CollectionSpec(environment, **from_stored(collection))
    if spec.category != content["category"]:
        raise ValueError(f"category is {content['category']!r}, but its objects are of {spec.category!r}")
    counts = content["attempts"]
    attempts = None if counts is None else AttemptCounts(**counts)
    return Manifest(spec, content["versions"], hashes, attempts, tuple(content["processors"]))
