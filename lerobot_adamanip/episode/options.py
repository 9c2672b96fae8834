"""Options of an environment: one frozen object for commands, configurations, the simulator and the manifest."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from lerobot_adamanip.contract.cameras import CAMERAS, FRONT
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.control import ACTION_NAMES, CONTROLS, DENSE, EE_DELTA, KEYFRAME, POSE, RATES, STATES
from lerobot_adamanip.contract.memory import NO_MEMORY, check_memory
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, FURTHEST_CORNER_M, Workspace, check_num_points
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS, IMAGE_SIZE, MAX_KEY_FRAMES
from lerobot_adamanip.contract.seeds import CHOOSE_SPLIT, SPLITS, BalancedDraws
from lerobot_adamanip.contract.sensing import EXACT, parse_sensing
from lerobot_adamanip.episode.hints import HINTED
from lerobot_adamanip.util.errors import ConfigurationError, require_choice, require_types

POSES = ("randomized", "fixed")
"""``randomized``: object, robot and camera pose are drawn; ``fixed``: nominal poses, as in upstream's code."""
RENDER_BACKENDS = ("auto", "cuda", "cpu")
"""``auto``: the first of the other two that works on this machine."""
CLOUD_SOURCES = ("raycast", "render")
"""``raycast``: by embreex, no renderer needed, without the ground; ``render``: by the renderer, six times slower."""
RAYCAST, RENDER = "raycast", "render"
IMAGE_SOURCES = (RAYCAST, RENDER)
"""``raycast``: coloured images by ray casting, on any machine; ``render``: by the renderer, which needs Vulkan."""
EPISODE_SECONDS = 30
"""Default duration of an episode of dense control [s]."""
IMAGE_SIZES, KEY_FRAMES, STEPS = (16, 2048), (1, 10_000), (1, 100_000)
"""Smallest and largest allowed value. Sizes of images are even, as videos need."""
BEST = "best"
"""Value of ``max_failed_tries``: the failed tries that the best blind strategy needs at worst, see the metrics."""
TIME_LIMIT, TOO_MANY_TRIES = "time limit", "more failed tries than allowed"
"""Limits that end an episode."""
MALFORMED_ACTION = "malformed action"
"""End of an evaluated episode whose policy has returned NaN or infinity."""
MAX_FAILED_TRIES = 1000
"""Largest allowed value."""
DEFAULT_LATE_STARTS = 0.15
"""Share of collected episodes that start from a perturbed mid-task state."""
OF_DENSE = ("fps", "action", "state", "max_steps")
"""Options that key frames do not read."""
STORED_NAMES = {"mechanism_rules": "mechanism_preset", "expert_strategy": "expert_preset"}
"""Option -> its key in files (manifests, episode logs), if the two differ."""


@dataclass(frozen=True)
class EnvironmentOptions:
    """All options of an environment except an episode's seed. Validated on creation; can be pickled.

    Attributes:
        category: ``bottle`` ... ``lamp``, see `lerobot_adamanip.contract.categories`.
        objects: ``seen``, ``unseen``, ``novel``, ``FIRST:END``, ``nFIRST:nEND`` or ids; an episode's seed
            selects one of them.
        assets: folder of external assets to use instead of generated objects; then ``seen`` means all of them.
        num_points: points per cloud.
        control: see `CONTROLS`.
        fps: steps per second of dense control [Hz], see `RATES`.
        action: kind of dense action, see `ACTION_NAMES`.
        state: kind of state in dense control, see `STATES`. Key frames have the contract's.
        max_steps: of a dense episode; None: `EPISODE_SECONDS`.
        observe_cloud, observe_effort: whether dense observations hold point cloud and effort. Key frames always do.
        memory: memory of felt tries in observations, see `contract.memory.MEMORIES`.
        image_size: side of an image [px].
        observe_images: whether observations hold images; None: in dense control, and if this machine renders.
        cameras: cameras of the images; None: all in dense control, the front camera in key frames.
        image_source: see `IMAGE_SOURCES`; None: ``raycast`` in dense control, ``render`` in key frames.
        poses: see `POSES`.
        mechanism_rules: see `lerobot_adamanip.mechanisms.MECHANISM_RULES`.
        max_key_frames: per episode.
        max_failed_tries: maximum failed tries; the next failed try ends the episode. A number, `BEST`, or None.
        hints: share of episodes whose instruction says what is hidden, 0 ... 1; see `episode.hints`.
        repeats: number of episodes in a row that play one scene, if their seeds follow each other or are not given.
        hidden_overrides: fixed hidden values, ``{"locked": True}``, for evaluation and tests.
        split: split of the scenes, see `contract.seeds.SPLITS`; a seed outside it is mapped into it.
        seed_offset: added to seeds, so that the categories of a suite have different scenes.
        sensing: errors of sensors, see `lerobot_adamanip.contract.sensing.parse_sensing`.
        self_calibration: whether clouds are corrected by the hand in them, see
            `lerobot_adamanip.hardware.calibration.self_calibration`.
        cloud_source: see `CLOUD_SOURCES`.
        render_backend: see `RENDER_BACKENDS`.
        episode_log: file to which each finished episode appends a line of JSON.
        run_id: id of the evaluation, in those lines; drawn anew by default.
        run_label: name of the run in reports, for instance the policy.
        logged_seeds: log only episodes whose seed, before mapping, is in this range (first, excluded end); default all.
        workspace: box that the cloud is cropped to, robot base frame [m]; or a mapping with ``lower`` and ``upper``.

    Raises:
        ConfigurationError: a value is invalid.
    """

    category: str = "safe"
    objects: str = "seen"
    assets: str | None = None
    num_points: int = DEFAULT_NUM_POINTS
    control: str = KEYFRAME
    fps: int = 10
    action: str = EE_DELTA
    state: str = POSE
    max_steps: int | None = None
    observe_cloud: bool = False
    observe_effort: bool = False
    memory: str = NO_MEMORY
    image_size: int = IMAGE_SIZE
    observe_images: bool | None = None
    cameras: tuple[str, ...] | None = None
    image_source: str | None = None
    poses: str = "randomized"
    mechanism_rules: str = "paper"
    max_key_frames: int = MAX_KEY_FRAMES
    max_failed_tries: int | str | None = None
    hints: float = 0.0
    repeats: int = 1
    hidden_overrides: Mapping[str, Any] = MappingProxyType({})
    split: str = "validation"
    seed_offset: int = 0
    sensing: str = EXACT
    self_calibration: bool = False
    cloud_source: str = "raycast"
    render_backend: str = "auto"
    episode_log: str | None = None
    run_id: str | None = None
    run_label: str | None = None
    logged_seeds: tuple[int, int] | None = None
    workspace: Workspace = DEFAULT_WORKSPACE

    def __post_init__(self) -> None:
        """Validates all values before a simulator starts."""
        if isinstance(self.workspace, Mapping):  # as `to_json` returns it
            object.__setattr__(self, "workspace", _workspace(self.workspace))
        for name in ("assets", "episode_log"):
            if isinstance(value := getattr(self, name), Path):
                object.__setattr__(self, name, str(value))
        require_types(self)
        require_choice("category", self.category, CATEGORIES)
        # Imported here, so that registering the plugin stays fast.
        from lerobot_adamanip.catalog import get_object, select_objects
        from lerobot_adamanip.mechanisms import make_mechanism, require_rules

        first = select_objects(self.category, self.objects, self.assets)[0]
        require_choice("poses", self.poses, POSES, hint="--env.poses=randomized")
        require_rules(self.category, self.mechanism_rules)
        self._normalise(first)
        require_choice("split of scenes", self.split, SPLITS, hint=CHOOSE_SPLIT)
        require_choice("source of clouds", self.cloud_source, CLOUD_SOURCES, hint="--env.cloud_source=raycast")
        sensing = "".join(self.sensing.lower().split())
        if sensing != EXACT:
            _check_sensing(sensing, self.cloud_source)
        object.__setattr__(self, "sensing", sensing.replace("+", ""))  # "+5" is 5, and "1e+1" is 1e1
        require_choice("render backend", self.render_backend, RENDER_BACKENDS, hint="--env.render_backend=auto")
        require_choice("control", self.control, CONTROLS, hint="--env.control=dense")
        require_choice("kind of action", self.action, ACTION_NAMES, hint="--env.action=ee_delta")
        require_choice("kind of state", self.state, STATES, hint="--env.state=pose")
        mechanism = make_mechanism(get_object(first, self.assets), self.mechanism_rules) if self.hints else None
        self._check_effect(HINTED if mechanism is None else mechanism.hidden_names)
        check_memory(self.memory, control=self.control, action=self.action)
        if self.fps not in RATES:
            raise ConfigurationError("Wrong rate of control.", got=self.fps, allowed=str(RATES), hint="--env.fps=10")
        if self.max_steps is not None:
            _check_range("number of steps per episode", self.max_steps, STEPS, "--env.episode_length=300")
        if self.image_source is not None:
            require_choice("source of images", self.image_source, IMAGE_SOURCES, hint="--env.image_source=raycast")
        check_num_points(self.num_points)
        _check_range("image size [px]", self.image_size, IMAGE_SIZES, "--env.image_size=256", step=2)
        _check_range("number of key frames per episode", self.max_key_frames, KEY_FRAMES, "--env.episode_length=45")
        if not 0 <= self.hints <= 1:
            raise ConfigurationError("Wrong share of hints.", got=self.hints, allowed="0 ... 1", hint="--env.hints=0.5")
        _check_range("number of repeats", self.repeats, (1, 1000), "--env.repeats=3")
        _check_range("seed offset", self.seed_offset, (0, 2**31), "seed_offset=0")
        _check_workspace(self.workspace)
        if self.logged_seeds is not None and not 0 <= self.logged_seeds[0] < self.logged_seeds[1]:
            raise ConfigurationError(
                "No seed is logged.",
                got=f"logged_seeds={tuple(self.logged_seeds)}",
                allowed="a first seed and an end above it",
                hint="--env.logged_seeds='[1000,1100]' for --seed=1000 --eval.n_episodes=100",
            )
        if self.episode_log is not None and Path(self.episode_log).is_dir():  # an empty path is this folder
            allowed, hint = "the path of a file, or None for no log", "--env.episode_log=outputs/episodes.jsonl"
            got = repr(self.episode_log)
            raise ConfigurationError("The episode log is not a file's path.", got=got, allowed=allowed, hint=hint)

    def _normalise(self, object_id: str) -> None:
        """Replaces hidden values, cameras and the limit of tries by plain ones; raises an error for wrong ones.

        A reset checks ranges of hidden values, which depend on the object.
        """
        from lerobot_adamanip.catalog import get_object
        from lerobot_adamanip.mechanisms import make_mechanism

        fixed = dict(self.hidden_overrides)
        if fixed:
            mechanism = make_mechanism(get_object(object_id, self.assets), self.mechanism_rules)
            drawn = mechanism.hidden(mechanism.draw(BalancedDraws(0, self.category)))
            ranges = {name for name, one in drawn.items() if isinstance(one, float)}
            positive = {name for name, one in fixed.items() if isinstance(one, float) and 0 < one < math.inf}
            chosen = {name: one for name, one in fixed.items() if name not in ranges & positive}
            drawn = mechanism.hidden(mechanism.draw(BalancedDraws(0, self.category), chosen))
            fixed |= {name: drawn[name] for name in chosen}
        object.__setattr__(self, "hidden_overrides", MappingProxyType(fixed))
        if self.cameras is not None:
            hint = "--env.cameras='[front,wrist]', or --env.observe_images=false"
            for name in self.cameras or ("",):  # none is not all
                require_choice("camera", name, CAMERAS, hint=hint)
            object.__setattr__(self, "cameras", tuple(dict.fromkeys(self.cameras)))
        tries = str(self.max_failed_tries)
        if self.max_failed_tries in (None, BEST):
            return
        if not tries.isdecimal() or len(tries) > 9 or int(tries) > MAX_FAILED_TRIES:  # Python reads no 5000 digits
            allowed = f"0 ... {MAX_FAILED_TRIES}, or {BEST}: as many as the best strategy needs at worst"
            hint = f"--env.max_failed_tries={BEST}"
            raise ConfigurationError("Wrong number of failed tries.", got=repr(tries[:80]), allowed=allowed, hint=hint)
        object.__setattr__(self, "max_failed_tries", int(tries))

    def _check_effect(self, hidden_names: Iterable[str]) -> None:
        """Refuses options that change nothing with this control, and hints where none of ``hidden_names`` has one."""
        if HINTED.isdisjoint(hidden_names):
            raise ConfigurationError(
                f"No hint exists for the category {self.category!r} with the mechanism rules {self.mechanism_rules!r}.",
                got=f"hints={self.hints:g}",
                allowed="hints=0, another category or other rules",
                hint="leave out --env.hints",
            )
        for name in () if self.is_dense else OF_DENSE:
            default = getattr(EnvironmentOptions, name)
            if getattr(self, name) != default:
                raise ConfigurationError(
                    f"{name} has no effect with control={self.control}.",
                    got=f"{name}={getattr(self, name)!r}",
                    allowed=f"{name}={default!r}, or control={DENSE}",
                    hint=f"--env.control={DENSE}",
                )
        if self.observes_cloud:
            return
        errors = parse_sensing(self.sensing)
        changes_picture = errors.camera_error_mm or errors.camera_error_deg or errors.steps_late(self.fps)
        changes_more = (self.observe_images is not False and changes_picture) or (
            self.observes_effort and errors.effort_noise_nm
        )
        if self.self_calibration:
            without, got = "Self-calibration corrects clouds", "self_calibration=True"
        elif self.sensing != EXACT and not changes_more:
            without, got = "These errors of sensors change clouds alone", f"sensing={self.sensing!r}"
        else:
            return
        raise ConfigurationError(
            f"{without}, but none is observed.",
            got=f"{got} with control={DENSE} and observe_cloud=False",
            allowed=f"observe_cloud=True, or self_calibration=False and sensing={EXACT!r}",
            hint="--env.observe_cloud=true",
        )

    @property
    def is_dense(self) -> bool:
        """Whether a step is a fixed time and not a key frame."""
        return self.control == DENSE

    @property
    def step_limit(self) -> int:
        """Maximum number of steps per episode."""
        return (self.max_steps or EPISODE_SECONDS * self.fps) if self.is_dense else self.max_key_frames

    @property
    def observed_cameras(self) -> tuple[str, ...]:
        """Cameras of the images, if images are observed."""
        return self.cameras or (tuple(CAMERAS) if self.is_dense else (FRONT,))

    @property
    def images_from(self) -> str:
        """One of `IMAGE_SOURCES`."""
        return self.image_source or (RAYCAST if self.is_dense else RENDER)

    @property
    def observes_cloud(self) -> bool:
        """Whether observations hold the point cloud."""
        return self.observe_cloud or not self.is_dense

    @property
    def observes_effort(self) -> bool:
        """Whether observations hold the effort."""
        return self.observe_effort or not self.is_dense

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles plain values, because a read-only mapping cannot be pickled."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return _restored, ({**values, "hidden_overrides": dict(self.hidden_overrides)},)

    def changed(self, **values: Any) -> EnvironmentOptions:
        """Returns a copy with other values; raises `ConfigurationError` for an unknown option.

        A change to key frames resets the options that they do not read.
        """
        require_known(values)
        is_reset = self.is_dense and values.get("control") == KEYFRAME
        reset = {name: getattr(EnvironmentOptions, name) for name in OF_DENSE if is_reset}
        return replace(self, **{**reset, **values})

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary of every option."""
        plain = {name: getattr(self, name) for name in (item.name for item in fields(self)) if name != "workspace"}
        return {**plain, "hidden_overrides": dict(self.hidden_overrides), "workspace": asdict(self.workspace)}


def to_stored(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns options under their keys in files, see `STORED_NAMES`."""
    return {STORED_NAMES.get(name, name): value for name, value in values.items()}


def from_stored(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the values of a file under the names of the options."""
    names = {stored: name for name, stored in STORED_NAMES.items()}
    return {names.get(name, name): value for name, value in values.items()}


def require_known(values: Mapping[str, Any]) -> None:
    """Raises `ConfigurationError` if a key is not an option of `EnvironmentOptions`."""
    known = [item.name for item in fields(EnvironmentOptions)]
    for name in values:
        require_choice("option of an environment", name, known)


def _restored(values: dict[str, Any]) -> EnvironmentOptions:
    return EnvironmentOptions(**values)


def check_late_starts(share: float) -> None:
    """Raises `ConfigurationError` unless ``share`` can be a share of episodes."""
    if not 0 <= share <= 1:
        raise ConfigurationError(
            "Wrong late_starts of a collection.", got=share, allowed="a share, 0 ... 1", hint="--late-starts 0.15"
        )


def _workspace(corners: Mapping[str, Any]) -> Workspace:
    for name in corners:
        require_choice("corner of a workspace", name, ("lower", "upper"))
    return Workspace(**corners)


def _check_sensing(sensing: str, cloud_source: str) -> None:
    parse_sensing(sensing)
    if cloud_source != RAYCAST:
        raise ConfigurationError(
            "Rendered clouds have no sensor errors.",
            got=f"sensing={sensing!r} with cloud_source={cloud_source!r}",
            allowed=f"cloud_source {RAYCAST}, or sensing {EXACT}",
            hint=f"--env.cloud_source={RAYCAST}",
        )


def _check_workspace(box: Workspace) -> None:
    corners = zip(box.lower, box.upper, strict=True)
    if not all(-FURTHEST_CORNER_M <= low < high <= FURTHEST_CORNER_M for low, high in corners):
        raise ConfigurationError(
            "Wrong workspace.",
            got=f"lower {box.lower}, upper {box.upper}",
            allowed=f"a lower corner below the upper one along x, y and z, within {FURTHEST_CORNER_M:g} m",
            hint=f"--env.workspace_lower={list(DEFAULT_WORKSPACE.lower)}",
        )


def _check_range(what: str, got: int, allowed: tuple[int, int], hint: str, step: int = 1) -> None:
    lowest, highest = allowed
    if got not in range(lowest, highest + 1, step):
        words = f"{lowest} ... {highest}{', even' if step == 2 else ''}"
        raise ConfigurationError(f"Wrong {what}.", got=got, allowed=words, hint=hint)
