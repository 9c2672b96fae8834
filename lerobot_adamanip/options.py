"""The options of an environment: one frozen object from a command line or config to the simulator and the manifest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from types import MappingProxyType
from typing import Any

from lerobot_adamanip.catalog import select_objects
from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.errors import ConfigurationError, require_choice
from lerobot_adamanip.mechanisms import MECHANISM_PRESETS
from lerobot_adamanip.pointcloud import DEFAULT_WORKSPACE, Workspace, check_num_points
from lerobot_adamanip.schema import DEFAULT_NUM_POINTS, IMAGE_SIZE, MAX_KEY_FRAMES

POSES = ("randomized", "fixed")
"""``randomized``: object, robot and camera pose are drawn; ``fixed``: nominal poses, as upstream's code has them."""
IMAGE_SIZES, KEY_FRAMES = (16, 2048), (1, 10_000)
"""Least and largest."""


@dataclass(frozen=True)
class EnvironmentOptions:
    """What decides an environment, apart from an episode's seed. Checked when it is made.

    Attributes:
        category: ``bottle`` ... ``lamp``, see `lerobot_adamanip.categories`.
        objects: which ones: ``seen``, ``unseen``, ``FIRST:END`` or ids; an episode's is drawn from its seed.
        assets: folder of external assets to use instead of generated objects; then ``seen`` means all of them.
        num_points: points per cloud.
        image_size: side of the front image [px].
        observe_images: whether observations hold the image.
        poses: see `POSES`.
        mechanism_preset: see `lerobot_adamanip.mechanisms.MECHANISM_PRESETS`.
        max_key_frames: per episode.
        hidden_overrides: fixed hidden values, ``{"locked": True}``, for evaluation and tests.
        episode_log: a file to which each ended episode's record is appended as a line of JSON.
        workspace: what of the scene the cloud keeps.

    Raises:
        ConfigurationError: a value cannot work.
    """

    category: str = "safe"
    objects: str = "seen"
    assets: str | None = None
    num_points: int = DEFAULT_NUM_POINTS
    image_size: int = IMAGE_SIZE
    observe_images: bool = True
    poses: str = "randomized"
    mechanism_preset: str = "paper"
    max_key_frames: int = MAX_KEY_FRAMES
    hidden_overrides: Mapping[str, Any] = MappingProxyType({})
    episode_log: str | None = None
    workspace: Workspace = DEFAULT_WORKSPACE

    def __post_init__(self) -> None:
        """Rejects what cannot work, before a simulator starts."""
        object.__setattr__(self, "hidden_overrides", MappingProxyType(dict(self.hidden_overrides or {})))
        for name in ("assets", "episode_log"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else str(value))
        require_choice("category", self.category, CATEGORIES)
        select_objects(self.category, self.objects, self.assets)
        require_choice("poses", self.poses, POSES, hint="--env.poses=randomized")
        require_choice("mechanism preset", self.mechanism_preset, MECHANISM_PRESETS)
        check_num_points(self.num_points)
        _check_range("image size [px]", self.image_size, IMAGE_SIZES, "--env.image_size=256")
        _check_range("number of key frames per episode", self.max_key_frames, KEY_FRAMES, "--env.episode_length=45")

    def changed(self, **values: Any) -> EnvironmentOptions:
        """Returns a copy with other values; raises `ConfigurationError` for a name that is no option."""
        require_known(values)
        return replace(self, **values)

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary of every option."""
        plain = {name: getattr(self, name) for name in (item.name for item in fields(self)) if name != "workspace"}
        return {**plain, "hidden_overrides": dict(self.hidden_overrides), "workspace": asdict(self.workspace)}


def require_known(values: Mapping[str, Any]) -> None:
    """Raises `ConfigurationError` if a key is no option of `EnvironmentOptions`."""
    known = [item.name for item in fields(EnvironmentOptions)]
    for name in values:
        if name == "pose_preset":
            raise ConfigurationError(
                "pose_preset is called poses now.",
                got=f"pose_preset={values[name]!r}",
                allowed="poses='randomized' (was default) or poses='fixed' (was paper)",
                hint="--env.poses=fixed, adamanip collect --poses fixed",
            )
        require_choice("option of an environment", name, known)


def _check_range(what: str, got: int, allowed: tuple[int, int], hint: str) -> None:
    lowest, highest = allowed
    if not lowest <= got <= highest:
        raise ConfigurationError(f"Wrong {what}.", got=got, allowed=f"{lowest} ... {highest}", hint=hint)
