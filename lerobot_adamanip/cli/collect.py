"""`adamanip collect`: record demonstrations of an expert as a LeRobotDataset."""

from __future__ import annotations

import dataclasses
import functools
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from lerobot_adamanip.cli.arguments import CategoryOrAll, DatasetFolder, print_result
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.datasets.repository_names import require_hub_name, require_repo_id
from lerobot_adamanip.episode.options import DEFAULT_LATE_STARTS, EnvironmentOptions
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.jobs import DEFAULT_TIMEOUT

if TYPE_CHECKING:
    from lerobot_adamanip.collection.collect import CollectOptions
    from lerobot_adamanip.collection.record import Factories
    from lerobot_adamanip.collection.summary import CollectSummary
    from lerobot_adamanip.datasets.collection_spec import CollectionSpec

EXIT_INTERRUPTED = 130
_STAGES = {"record": "recorded in all", "assemble": "writing the dataset"}


@dataclass
class Collect:
    """Records demonstrations of a scripted expert as a LeRobotDataset.

    Every finished episode is safe on disk at once: after Ctrl-C, a crash or a power cut the same command resumes. One
    seed gives one dataset, whatever the number of workers and of interruptions.
    """

    root: DatasetFolder
    """Folder of the new dataset. Until it is complete, episodes wait in DIR.partial."""

    category: CategoryOrAll = "safe"
    """Which kind of object; all for one dataset of every category."""

    expert: Literal["adaptive", "static"] = "adaptive"
    """adaptive: knows what a policy can know, tries, recovers. static: sees the hidden state, goes straight there."""

    episodes_per_object: int = 20
    """Successful episodes to keep of each object."""

    objects: str = "seen"
    """seen, unseen, novel, FIRST:END (0:4; seen ones), nFIRST:nEND (n0:n4; novel ones), or ids separated by commas."""

    assets: Path | None = None
    """Folder of external assets, to use instead of generated objects; seen then means all of them. Give it again to
    resume: the dataset remembers what is in it, not where it is."""

    num_points: int = schema.DEFAULT_NUM_POINTS
    """Points per cloud. The paper's protocol has 4096; LeRobot reads fewer much faster."""

    image_size: int = schema.IMAGE_SIZE
    """Side of the front image [px]."""

    images: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Record pictures, or fail at once where nothing renders. By default: pictures where something renders."""

    no_images: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Record no pictures: no Vulkan device is needed, and `adamanip render` adds them later."""

    cloud_source: Literal["raycast", "render"] = "raycast"
    """raycast: clouds by ray casting. render: by the renderer, ten times slower. They are the same."""

    poses: Literal["randomized", "fixed"] = "randomized"
    """randomized: object, robot and camera pose are drawn. fixed: nominal poses, as upstream's code has them."""

    mechanism_rules: Literal["paper", "upstream", "hard"] = "paper"
    """paper: mechanisms as the paper's text has them. upstream: as its released code has them. hard: harder ones."""

    expert_strategy: Literal["paper", "upstream", "to_stop"] = "paper"
    """When the adaptive expert tries to open. paper: at random, even before anything was turned. upstream: only beyond
    its code's fixed angles. to_stop: where it has felt a stop, which wastes the fewest tries."""

    trials: int = 1
    """Failed tries the adaptive expert demonstrates before it changes its mind."""

    late_starts: float = DEFAULT_LATE_STARTS
    """Share of episodes that start where another hand has driven some key frames and lost its grip."""

    keep_failed: bool = False
    """Keep failed episodes too, in a second dataset, DIR-failed."""

    policy: Path | None = None
    """Policy to correct: its folder pretrained_model. The policy drives, and the expert labels every key frame with the
    action that it would take (DAgger)."""

    expert_share: float = 0.3
    """With --policy: share of key frames that the expert drives, so that the episode gets on."""

    seed: int = 0
    """Of the whole collection."""

    workers: int = 1
    """Processes, each with a simulator of its own; with --cluster actors, 0: one per CPU. Does not change the data."""

    worker_timeout: float = DEFAULT_TIMEOUT
    """A worker that gives no heartbeat (a key frame, an episode) for so long is replaced [s]. With --cluster: one
    that takes longer for one episode with all its attempts."""

    cluster: str | None = None
    """Ray cluster to record on: HOST:PORT, auto (the one this machine belongs to) or local (this machine alone)."""

    insecure_cluster: bool = False
    """Use a cluster that demands no token: anyone who reaches its ports runs code on it."""

    part: str | None = None
    """K/N: record only every N-th episode, from the K-th on, and make no dataset yet; for one of N machines."""

    adopt: tuple[Path, ...] = ()
    """Roots of such parts: take over what they recorded, record what is missing, and make the dataset."""

    repo_id: str | None = None
    """Name of the dataset, in its card and on the Hub. local/<folder name> by default."""

    max_attempts: int = 5
    """Episodes to try for each one kept, before its object is reported as too hard."""

    allow_missing: bool = False
    """Write the dataset even if some episodes could not be recorded."""

    push_to_hub: bool = False
    """Publish the finished dataset as --repo-id, as `adamanip push dataset` does."""

    private: bool = False
    """Make the uploaded dataset private."""

    json: bool = False
    """Print one JSON object when done. Progress goes to stderr."""

    def run(self) -> int:
        """Collects, and publishes if asked to; 0 when the dataset is complete, 130 after Ctrl-C."""
        if self.push_to_hub:
            require_hub_name(self.repo_id)
        require_repo_id(self.repo_id, suffix="-failed" if self.keep_failed else "")
        self._require_whole()
        from lerobot_adamanip.cli.collect_setup import begin

        options, spec = self.options(), self.spec()
        begin(spec, self.workers, self.cluster, self.part)
        try:
            with show_progress(_STAGES, every_stage=True) as progress:
                from lerobot_adamanip.collection.collect import collect

                summary = collect(self.root, spec, self._factories(), options, progress)
        except KeyboardInterrupt:
            command = shlex.join(["adamanip", *sys.argv[1:]])
            print(f"Interrupted. Every finished episode is kept. To resume:\n  {command}", file=sys.stderr)
            return EXIT_INTERRUPTED
        if self.push_to_hub:
            self._publish()
        rate = {"episodes_per_minute": round(summary.episodes_per_minute, 3)}
        print_result(self.json, {**dataclasses.asdict(summary), **rate}, self._text(summary))
        return 0

    def _publish(self) -> None:
        """What `adamanip push dataset` does: that command goes on if this is interrupted."""
        from lerobot_adamanip.cli.push import Push

        push = Push("dataset", str(self.repo_id), self.root, assets=self.assets, private=self.private)
        _, result = push.publish()
        print(f"Published: {result.url if result else self.repo_id}", file=sys.stderr)

    def _require_whole(self) -> None:
        """A part makes no dataset, so there is none to upload."""
        if self.part is not None and (self.push_to_hub or self.adopt):
            raise ConfigurationError(
                "A part of a collection makes no dataset.",
                got="--part with --push-to-hub or --adopt",
                allowed="--part alone",
                hint="adamanip collect DIR ... --adopt PART1 PART2, once all parts are recorded",
            )

    def spec(self) -> CollectionSpec:
        """Returns what is to be collected; raises `ConfigurationError` for what cannot be."""
        from lerobot_adamanip.cli.collect_setup import objects_to_collect, resolve_images
        from lerobot_adamanip.datasets.collection_spec import CollectionSpec

        categories = tuple(CATEGORIES) if self.category == ALL else (self.category,)
        environment = EnvironmentOptions(
            category=categories[0],
            objects=self.objects,
            assets=None if self.assets is None else str(self.assets.resolve()),
            num_points=self.num_points,
            image_size=self.image_size,
            cloud_source=self.cloud_source,
            poses=self.poses,
            mechanism_rules=self.mechanism_rules,
        )
        spec = CollectionSpec(
            environment=environment,
            objects=objects_to_collect(categories, self.objects, self.assets, self.poses),
            expert=self.expert,
            expert_strategy=self.expert_strategy,
            episodes_per_object=self.episodes_per_object,
            trials=self.trials,
            late_starts=self.late_starts,
            keep_failed=self.keep_failed,
            policy=self._policy_hash(),
            expert_share=1.0 if self.policy is None else self.expert_share,
            seed=self.seed,
        )
        # Last: finding a renderer may take seconds.
        images = resolve_images((self.root, *self.adopt), self.images, self.no_images)
        return dataclasses.replace(spec, environment=environment.changed(observe_images=images))

    def options(self) -> CollectOptions:
        """Returns how it is to be collected; raises `ConfigurationError` for what cannot be."""
        from lerobot_adamanip.collection.collect import CollectOptions
        from lerobot_adamanip.collection.parts import Part

        return CollectOptions(
            workers=self.workers,
            worker_timeout=self.worker_timeout,
            max_attempts=self.max_attempts,
            allow_missing=self.allow_missing,
            repo_id=self.repo_id,
            cluster=self.cluster,
            insecure_cluster=self.insecure_cluster,
            part=None if self.part is None else Part.parse(self.part),
            adopt=self.adopt,
        )

    def _policy_hash(self) -> str:
        if self.policy is None:
            return ""
        from lerobot_adamanip.collection.trained_policy import policy_hash  # with torch, which nobody else waits for

        return policy_hash(self.policy)

    def _factories(self) -> Factories:
        if self.policy is None:
            return factories()
        from lerobot_adamanip.collection.trained_policy import TrainedPolicy

        return dataclasses.replace(factories(), actor=functools.partial(TrainedPolicy, self.policy))

    def _text(self, summary: CollectSummary) -> str:
        if self.part is not None:
            return f"Part {self.part}: {summary.episodes} episodes in {summary.root}, {summary.recorded} of them new."
        if summary.recorded == 0 and not self.adopt:
            return f"Complete already: {summary.episodes} episodes in {summary.root}"
        lines = [
            f"{summary.episodes} episodes in {summary.root} ({summary.bytes / 1e6:.1f} MB): "
            f"{summary.recorded} recorded in {summary.recording_seconds:.0f} s, "
            f"{summary.episodes_per_minute:.1f} per minute; the {'policy' if self.policy else 'expert'} succeeded in "
            f"{100 * summary.success_rate:.1f} % of its {summary.attempted} attempts."
        ]
        if len(summary.categories) > 1:
            lines += _category_lines(summary)
        return "\n".join([*lines, *(f"missing: {line}" for line in summary.failures)])


def _category_lines(summary: CollectSummary) -> Iterator[str]:
    yield f"{'category':16} {'episodes':>8} {'attempts':>8} {'key frames':>10} {'per worker and minute':>21}"
    for name, row in summary.categories.items():
        rate = f"{row.episodes_per_worker_minute:.1f}" if row.recorded else "-"
        yield f"{name:16} {row.episodes:8} {row.attempts:8} {row.mean_key_frames:10.1f} {rate:>21}"


def factories() -> Factories:
    """Returns the simulator and the scripted experts that demonstrations are recorded with."""
    from lerobot_adamanip.collection.record import Factories
    from lerobot_adamanip.experts import make_expert
    from lerobot_env_adamanip.make_env import make_keyframe_env

    return Factories(make_keyframe_env, make_expert)
