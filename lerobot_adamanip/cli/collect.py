"""`adamanip collect`: record demonstrations of an expert as a LeRobotDataset."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from lerobot_adamanip import schema
from lerobot_adamanip.catalog import select_objects
from lerobot_adamanip.categories import ALL, CATEGORIES
from lerobot_adamanip.demos.collect import CollectSummary, Listener, collect
from lerobot_adamanip.demos.collection import CollectionSpec
from lerobot_adamanip.hub.publish import publish, require_hub_name

EXIT_INTERRUPTED = 130
_STAGES = {"record": "recorded in all", "assemble": "writing the dataset"}


@dataclass
class Collect:
    """Records demonstrations of a scripted expert as a LeRobotDataset.

    Every finished episode is safe on disk at once: after Ctrl-C, a crash or a power cut the same command resumes. One
    seed gives one dataset, whatever the number of workers and of interruptions.
    """

    root: Path
    """Folder of the dataset. Until it is complete, episodes wait in ROOT.partial."""

    category: str = "safe"
    """Which kind of object; all for one dataset of every category."""

    expert: Literal["adaptive", "static"] = "adaptive"
    """adaptive: knows what a policy can know, tries, recovers. static: sees the hidden state, goes straight there."""

    episodes_per_object: int = 20
    """Successful episodes to keep of each object."""

    objects: str = "seen"
    """seen, unseen, FIRST:END (0:4), or ids separated by commas (safe_000,safe_007)."""

    assets: Path | None = None
    """Folder of objects of others, to use instead of generated ones; seen then means all of them."""

    num_points: int = schema.DEFAULT_NUM_POINTS
    """Points per cloud. The paper's protocol has 4096; LeRobot reads fewer much faster."""

    pose_preset: Literal["default", "paper"] = "default"
    """default randomises object, robot and camera pose; paper fixes them."""

    mechanism_preset: Literal["paper", "upstream"] = "paper"
    """paper: mechanisms as the paper's text has them. upstream: as its released code has them."""

    expert_preset: Literal["paper", "upstream"] = "paper"
    """paper: opening may be tried before anything was turned. upstream: only beyond its code's fixed angles."""

    trials: int = 1
    """Failed tries the adaptive expert demonstrates before it changes its mind."""

    seed: int = 0
    """Of the whole collection."""

    workers: int = 1
    """Processes, each with a simulator of its own. Does not change the data."""

    repo_id: str | None = None
    """Name of the dataset, in its card and on the Hub. local/<folder name> by default."""

    max_attempts: int = 5
    """Episodes to try for each one kept, before its object is reported as too hard."""

    allow_missing: bool = False
    """Write the dataset even if some episodes could not be recorded."""

    push_to_hub: bool = False
    """Upload the finished dataset as --repo-id (licence apache-2.0)."""

    private: bool = False
    """Make the uploaded dataset private."""

    json: bool = False
    """Print one JSON object when done, and no progress."""

    def run(self) -> int:
        """Collects, and publishes if asked to; 0 when the dataset is complete, 130 after Ctrl-C."""
        if self.push_to_hub:
            require_hub_name(self.repo_id)
        options = CollectionSpec(
            category=self.category,
            objects=self._objects(),
            expert=self.expert,
            episodes_per_object=self.episodes_per_object,
            num_points=self.num_points,
            trials=self.trials,
            seed=self.seed,
        )
        env_options = _changed(
            assets=(None if self.assets is None else str(self.assets.resolve()), None),
            poses=({"default": "randomized", "paper": "fixed"}[self.pose_preset], "randomized"),
            mechanism_preset=(self.mechanism_preset, "paper"),
        )
        expert_options = _changed(preset=(self.expert_preset, "paper"))
        if env_options:
            options = dataclasses.replace(options, env_options=env_options)
        if expert_options:
            options = dataclasses.replace(options, expert_options=expert_options)
        try:
            summary = self._collect(options)
        except KeyboardInterrupt:
            command = shlex.join(["adamanip", *sys.argv[1:]])
            print(f"Interrupted. Every finished episode is kept. To resume:\n  {command}", file=sys.stderr)
            return EXIT_INTERRUPTED
        if self.push_to_hub:
            publish(self.root, str(self.repo_id), private=self.private)
        self._print(summary)
        return 0

    def _objects(self) -> tuple[str, ...]:
        if self.category != ALL:
            return select_objects(self.category, self.objects, self.assets)
        return tuple(name for category in CATEGORIES for name in select_objects(category, self.objects, self.assets))

    def _collect(self, options: CollectionSpec) -> CollectSummary:
        # What libraries print must not get into the JSON.
        with _progress(quiet=self.json) as listener, contextlib.redirect_stdout(sys.stderr):
            return collect(
                self.root,
                options,
                workers=self.workers,
                repo_id=self.repo_id,
                max_attempts=self.max_attempts,
                allow_missing=self.allow_missing,
                listener=listener,
            )

    def _print(self, summary: CollectSummary) -> None:
        if self.json:
            rate = {"episodes_per_minute": round(summary.episodes_per_minute, 3)}
            print(json.dumps({**dataclasses.asdict(summary), **rate}))
            return
        if summary.recorded == 0:
            print(f"Complete already: {summary.episodes} episodes in {summary.root}")
            return
        print(
            f"{summary.episodes} episodes in {summary.root} ({summary.bytes / 1e6:.1f} MB): "
            f"{summary.recorded} recorded in {summary.recording_seconds:.0f} s, "
            f"{summary.episodes_per_minute:.1f} per minute; the expert succeeded in "
            f"{100 * summary.expert_success_rate:.1f} % of its attempts."
        )
        if len(summary.categories) > 1:
            _print_categories(summary)
        for line in summary.failures:
            print(f"missing: {line}")


def _changed(**presets: tuple[str | None, str | None]) -> dict[str, str | None]:
    """Returns the presets that are not the default ones: a manifest holds no more than what was asked for."""
    return {name: value for name, (value, default) in presets.items() if value != default}


def _print_categories(summary: CollectSummary) -> None:
    print(f"{'category':16} {'episodes':>8} {'attempts':>8} {'key frames':>10} {'per worker and minute':>21}")
    for name, row in summary.categories.items():
        rate = f"{row.episodes_per_worker_minute:.1f}" if row.recorded else "-"
        print(f"{name:16} {row.episodes:8} {row.attempts:8} {row.mean_key_frames:10.1f} {rate:>21}")


@contextlib.contextmanager
def _progress(*, quiet: bool) -> Iterator[Listener]:
    from rich import progress as bars
    from rich.console import Console

    columns = (
        bars.TextColumn("{task.description}"),
        bars.BarColumn(),
        bars.MofNCompleteColumn(),
        bars.TimeElapsedColumn(),
        bars.TimeRemainingColumn(),
    )
    with bars.Progress(*columns, console=Console(stderr=True), disable=quiet) as progress:
        tasks: dict[str, bars.TaskID] = {}

        def listen(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = progress.add_task(_STAGES.get(stage, stage.removeprefix("record ")), total=total)
            progress.update(tasks[stage], completed=done, total=total)

        yield listen
