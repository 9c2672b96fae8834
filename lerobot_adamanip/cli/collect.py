"""`adamanip collect`: records demonstrations of an expert as a LeRobotDataset."""

from __future__ import annotations

import dataclasses
import functools
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from lerobot_adamanip.cli.arguments import (
    CategoryOrAll,
    DatasetFolder,
    print_result,
    require_effects,
    require_expert_options,
)
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.contract.control import DENSE, EE_POSE, FULL
from lerobot_adamanip.contract.sensing import EXACT
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.episode.options import DEFAULT_LATE_STARTS, EnvironmentOptions, check_late_starts
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.jobs import DEFAULT_TIMEOUT

if TYPE_CHECKING:
    from lerobot_adamanip.collection.collect import CollectOptions
    from lerobot_adamanip.collection.record import Factories
    from lerobot_adamanip.datasets.collection_spec import CollectionSpec

EXIT_INTERRUPTED = 130
_STAGES = {"record": "recorded in all", "assemble": "writing the dataset"}


@dataclass
class CollectCommand:
    """Records demonstrations of a scripted expert as a LeRobotDataset.

    Every finished episode is on disk at once: after Ctrl-C, a crash or a power cut the same command resumes. The same
    seed gives the same dataset, with any number of workers and interruptions.
    """

    root: DatasetFolder
    """Folder of the new dataset. Unfinished, its episodes are in DIR.partial."""

    category: CategoryOrAll = "safe"
    """Category of the objects; all for one dataset of every category."""

    expert: Literal["adaptive", "static"] = "adaptive"
    """Expert. adaptive: knows no hidden state, tries and recovers. static: knows it. Both know the parts' poses."""

    episodes_per_object: int = 20
    """Number of successful episodes to keep per object."""

    objects: str = "seen"
    """Objects: seen, unseen, novel, FIRST:END (0:4, seen ones), nFIRST:nEND (n0:n4, novel ones), or ids separated by
    commas."""

    assets: Path | None = None
    """Folder of external assets, used instead of generated objects; --objects seen means all of them. Needed again to
    resume: the dataset stores hashes of the assets, not their path."""

    control: Literal["keyframe", "dense"] = "keyframe"
    """One row is a key frame, or 1/fps seconds (dense), as other policies of LeRobot need it."""

    fps: int = 10
    """Rows per second of dense control: 5, 10 or 25 [Hz]."""

    action: Literal["ee_delta", "ee_pose", "joint"] = "ee_delta"
    """Dense action. ee_delta: motion of the tool from its measured pose, 7 numbers in -1 ... 1. ee_pose: the tool's
    pose, 10 numbers. joint: joint positions and gripper, 8 numbers."""

    state: Literal["pose", "full"] = "pose"
    """Dense state. pose: tool position, rotation vector, fingers. full: the contract's 24 numbers."""

    cloud: bool = False
    """Record point clouds in dense control too."""

    effort: bool = False
    """Record joint torques in dense control too."""

    cameras: tuple[Literal["front", "wrist"], ...] = ()
    """Cameras of the pictures. Default: front and wrist in dense control, front for key frames."""

    image_source: Literal["raycast", "render"] | None = None
    """Source of pictures. raycast: on any machine. render: needs Vulkan. Default: raycast in dense control, else
    render."""

    memory: Literal["none", "events", "text"] = "none"
    """Memory of felt tries. events: numbers in observation.environment_state, for ACT and diffusion. text: a sentence
    after the instruction, for SmolVLA and pi0.5. `adamanip memory` adds it later."""

    unscaled_poses: bool = False
    """Leave rotation and gripper of poses unscaled in meta/stats.json, for policies that normalise each number, such as
    ACT: a number that hardly varies would be magnified."""

    num_points: int = schema.DEFAULT_NUM_POINTS
    """Points per cloud. The paper uses 4096; LeRobot reads fewer much faster."""

    image_size: int | None = None
    """Side length of the pictures [px], e.g. 256, the default. With the source render, this option makes a machine that
    cannot render fail at once; without it, such a machine records no pictures."""

    no_images: bool = False
    """Record no pictures; `adamanip render` adds them later."""

    cloud_source: Literal["raycast", "render"] = "raycast"
    """Source of point clouds. raycast: ray casting. render: the renderer, six times slower, with equal clouds."""

    poses: Literal["randomized", "fixed"] = "randomized"
    """Poses of object, robot and camera. randomized: drawn. fixed: nominal, as in upstream's code."""

    mechanism_rules: Literal["paper", "upstream", "hard", "row", "changing"] = "paper"
    """Rules of mechanisms. paper: as in the paper's text. upstream: its released code, other for safes. hard: drawn
    directions for pressure cookers and coffee makers too. row: three locks in a row. changing: a lock that may shut
    again."""

    hints: float = 0.0
    """Share of episodes whose instruction says what is hidden, as "Open the door. It turns left."."""

    sensing: str = EXACT
    """Errors of sensors. exact: none. d435: a calibrated D435. rough: twice as bad. Single parts may be changed, e.g.
    d435,camera_error_mm=20."""

    self_calibration: bool = False
    """Correct each cloud by the robot's hand in it, whose shape and pose are known."""

    max_failed_tries: str | None = None
    """Maximum failed tries per attempt; the next failed try ends it. A number, or best (worst case of the best strategy
    without the hidden state). Default: no limit."""

    expert_strategy: Literal["paper", "upstream", "to_stop"] = "paper"
    """When the adaptive expert tries to open. paper: at random, even before a turn. upstream: beyond the fixed angles
    of upstream's code. to_stop: at a felt stop, with the fewest failed tries."""

    trials: int = 1
    """Failed pulls at a part that is held (at a lamp: tries of a motion) before the adaptive expert does something
    else."""

    late_starts: float = DEFAULT_LATE_STARTS
    """Share of episodes that start mid-task, after some key frames and a lost grip. 0 for none."""

    mistakes: float = 0.0
    """Share of the key frames in which the arm executes a mistake: stops short, moves the wrong way, lets go, repeats a
    failed try, pulls before the turn. Rows keep the expert's own action, e.g. 0.2. 0 for none."""

    keep_failed: bool = False
    """Keep failed episodes in a second dataset, DIR-failed."""

    policy: Path | None = None
    """Policy to correct (DAgger): its folder pretrained_model. The policy drives, and the expert labels every row with
    its own action."""

    expert_share: float = 0.3
    """With --policy: share of the expert's key frames that it drives itself, so that episodes make progress."""

    seed: int = 0
    """Seed of the whole collection."""

    workers: int = 1
    """Number of worker processes with a simulator each. With --cluster: number of actors, 0 for one per CPU. Does not
    change the data."""

    worker_timeout: float = DEFAULT_TIMEOUT
    """Time without a heartbeat (a key frame, an episode) after which a worker is replaced [s]. With --cluster: time
    for an episode with all its attempts."""

    cluster: str | None = None
    """Ray cluster to record on: HOST:PORT, auto (the one of this machine) or local (this machine alone)."""

    insecure_cluster: bool = False
    """Use a cluster without a token: anyone who reaches its ports can run code on it."""

    part: str | None = None
    """K/N, for one of N machines (1/8): record every N-th episode from the K-th on, and make no dataset."""

    adopt: tuple[Path, ...] = ()
    """Folders of parts: import their episodes, record the missing ones, and make the dataset."""

    repo_id: str | None = None
    """Name of the dataset in its card and on the Hub. Default: local/<folder name>."""

    max_attempts: int = 5
    """Attempts at an episode before it is given up."""

    allow_missing: bool = False
    """Make the dataset even if some episodes were given up."""

    json: bool = False
    """Print one JSON object when done. Progress goes to stderr."""

    def run(self) -> int:
        """Collects. Returns 0 for a complete dataset, 130 after Ctrl-C."""
        require_repo_id(self.repo_id, suffix="-failed" if self.keep_failed else "")
        spec = self._spec_without_images()
        from lerobot_adamanip.cli.collect_setup import announce, no_pictures, summary_text
        from lerobot_adamanip.collection.partial import require_same_options

        options = self.options()
        spec = self._with_images(spec)
        require_same_options(self.root, spec)
        if self.policy is not None:
            from lerobot_adamanip.collection.trained_policy import register_policies
            from lerobot_env_adamanip.policy_check import configuration_of, require_fitting_checkpoint

            register_policies()
            require_fitting_checkpoint(str(self.policy), configuration_of(spec.environment), self._categories())
        announce(spec, self.workers, self.cluster, self.part)
        try:
            with show_progress(_STAGES, every_stage=True) as progress:
                from lerobot_adamanip.collection.collect import collect
                from lerobot_adamanip.datasets.collection_spec import CollectionPaths
                from lerobot_adamanip.datasets.pose_statistics import leave_poses_unscaled

                summary = collect(self.root, spec, self._factories(), options, progress)
        except KeyboardInterrupt:
            command = shlex.join(["adamanip", *sys.argv[1:]])
            print(f"Interrupted. Every finished episode is kept. To resume:\n  {command}", file=sys.stderr)
            return EXIT_INTERRUPTED
        if self.unscaled_poses and self.part is None:
            failed = CollectionPaths(self.root).failed
            for folder in (self.root, failed) if self.keep_failed and failed.is_dir() else (self.root,):
                leave_poses_unscaled(folder)
        rate = {"episodes_per_minute": round(summary.episodes_per_minute, 3)}
        text = summary_text(summary, self.part, self.adopt, "policy" if self.policy else "expert")
        print_result(self.json, {**dataclasses.asdict(summary), **rate}, text)
        if not (spec.environment.observe_images or self.no_images):
            print(no_pictures(f"adamanip render {self.root}"), file=sys.stderr)
        return 0

    def spec(self) -> CollectionSpec:
        """Returns the options that decide the data; raises `ConfigurationError`."""
        return self._with_images(self._spec_without_images())

    def _with_images(self, spec: CollectionSpec) -> CollectionSpec:
        """Decides on pictures, after all checks: finding a renderer may take seconds."""
        from lerobot_adamanip.cli.collect_setup import resolve_images

        is_drawn = spec.environment.images_from == "raycast"
        images = not self.no_images and (
            is_drawn or resolve_images((self.root, *self.adopt), self.image_size is not None)
        )
        return dataclasses.replace(spec, environment=spec.environment.changed(observe_images=images))

    def _spec_without_images(self) -> CollectionSpec:
        from lerobot_adamanip.cli.collect_setup import objects_to_collect

        require_expert_options(self.expert, self.trials, self.expert_strategy, self.mechanism_rules)
        idle: dict[str, tuple[str, ...]] = {
            "with --control dense": () if self.control == DENSE else ("fps", "action", "state", "cloud", "effort"),
            "with --policy": () if self.policy else ("expert_share",),
            "with --cluster": () if self.cluster else ("insecure_cluster",),
            "with --expert adaptive": () if self.expert == "adaptive" else ("expert_strategy",),
            "without --part": ("unscaled_poses",) if self.part else (),
            "with --action ee_pose or --state full": () if self._has_poses() else ("unscaled_poses",),
        }
        require_effects(self, idle)
        categories = self._categories()
        same = (
            "objects", "num_points", "cloud_source", "poses", "mechanism_rules", "sensing", "self_calibration",
            "max_failed_tries", "hints", "control", "fps", "action", "state", "memory", "image_source",
        )  # fmt: skip
        environment = EnvironmentOptions(
            category=categories[0],
            assets=None if self.assets is None else str(self.assets.resolve()),
            image_size=schema.IMAGE_SIZE if self.image_size is None else self.image_size,
            observe_cloud=self.cloud,
            observe_effort=self.effort,
            cameras=self.cameras or None,
            **{name: getattr(self, name) for name in same},
        )
        objects = objects_to_collect(categories, self.objects, self.assets, self.poses)
        check_late_starts(self.late_starts)
        from lerobot_adamanip.datasets.collection_spec import CollectionSpec  # with scipy, after the checks

        policy = ""
        if self.policy is not None:
            from lerobot_adamanip.collection.trained_policy import policy_hash  # imports torch

            policy = policy_hash(self.policy)
        unchanged = (
            "expert", "expert_strategy", "episodes_per_object", "trials", "late_starts", "keep_failed", "mistakes",
            "seed",
        )  # fmt: skip
        return CollectionSpec(
            environment=environment,
            objects=objects,
            policy=policy,
            expert_share=1.0 if self.policy is None else self.expert_share,
            **{name: getattr(self, name) for name in unchanged},
        )

    def _categories(self) -> tuple[str, ...]:
        return tuple(CATEGORIES) if self.category == ALL else (self.category,)

    def _has_poses(self) -> bool:
        """Whether states or actions are poses."""
        return self.control != DENSE or self.action == EE_POSE or self.state == FULL

    def options(self) -> CollectOptions:
        """Returns the options that do not change the data; raises `ConfigurationError`."""
        from lerobot_adamanip.collection.collect import CollectOptions
        from lerobot_adamanip.collection.partial import Part

        if self.part is not None and self.adopt:
            raise ConfigurationError(
                "A part of a collection makes no dataset.",
                got="--part with --adopt",
                allowed="--part alone",
                hint="adamanip collect DIR ... --adopt PART1 PART2, once all parts are recorded",
            )
        same = ("workers", "worker_timeout", "max_attempts", "allow_missing", "repo_id", "cluster", "insecure_cluster")
        part = None if self.part is None else Part.parse(self.part)
        return CollectOptions(**{name: getattr(self, name) for name in same}, part=part, adopt=self.adopt)

    def _factories(self) -> Factories:
        if self.policy is None:
            return factories()
        from lerobot_adamanip.collection.trained_policy import TrainedPolicy

        return dataclasses.replace(factories(), actor=functools.partial(TrainedPolicy, self.policy))


def factories() -> Factories:
    """Returns the factories of simulators and scripted experts."""
    from lerobot_adamanip.collection.record import Factories
    from lerobot_adamanip.experts import make_expert
    from lerobot_env_adamanip.make_environment import make_environment

    return Factories(make_environment, make_expert)
