"""`adamanip expert`: evaluates a scripted expert in the scenes in which `lerobot-eval` evaluates policies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from lerobot_adamanip.cli.arguments import Category, print_result, require_expert_options
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.contract.schema import MAX_KEY_FRAMES
from lerobot_adamanip.contract.seeds import MAX_SEED, Stream, episode_generator
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.util.errors import ConfigurationError

if TYPE_CHECKING:
    from lerobot_adamanip.episode.rollout import SimulatedEnvironment
    from lerobot_adamanip.evaluation.record import EpisodeRecord


@dataclass
class ExpertCommand:
    """Evaluates a scripted expert: the scenes, the limits and the log are those of `lerobot-eval`.

    An expert knows the poses of the parts. The adaptive expert does not know the hidden state, so its result is that of
    a policy with perfect perception and memory.
    """

    category: Category = "safe"
    """Category of the objects."""

    expert: Literal["adaptive", "static"] = "adaptive"
    """Expert. adaptive: knows no hidden state, tries and recovers. static: knows it. Both know the parts' poses."""

    expert_strategy: Literal["paper", "upstream", "to_stop"] = "to_stop"
    """When the adaptive expert tries to open, see `adamanip collect`. to_stop: with the fewest failed tries."""

    trials: int = 1
    """Failed pulls at a part that is held (at a lamp: tries of a motion) before the adaptive expert does something
    else."""

    objects: str = "seen"
    """Objects: seen, unseen, novel, FIRST:END, nFIRST:nEND, or ids separated by commas."""

    split: str = "validation"
    """Split of scenes: train, validation, or test (for reported numbers)."""

    poses: str = "randomized"
    """Poses of object, robot and camera: randomized or fixed."""

    mechanism_rules: str = "paper"
    """Rules of mechanisms: paper, upstream, hard (for pressure_cooker and coffee_maker), row or changing."""

    sensing: str = "exact"
    """Errors of sensors and arm, as of `--env.sensing`. The expert sees none of them: its episodes do not change."""

    hints: float = 0.0
    """Share of episodes whose instruction says what is hidden. The expert reads none: its episodes do not change."""

    repeats: int = 1
    """Episodes in a row that play one scene. The expert forgets it after each episode."""

    episode_length: int = MAX_KEY_FRAMES
    """Maximum key frames per episode."""

    max_failed_tries: str | None = None
    """Maximum failed tries per episode: a number, or best. Default: no limit."""

    episodes: int = 50
    """Number of scenes."""

    seed: int = 1000
    """Seed of the first scene, as in `lerobot-eval`."""

    episode_log: Path = Path("outputs/expert/episodes.jsonl")
    """New file for the episodes' records, for `adamanip report`."""

    json: bool = False
    """Print one JSON object instead of tables."""

    def run(self) -> int:
        """Runs the episodes and reports them. Returns 0."""
        require_expert_options(self.expert, self.trials, self.expert_strategy, self.mechanism_rules)
        if self.episodes < 1:
            raise ConfigurationError("No episode.", got=self.episodes, allowed="1 or more", hint="--episodes 50")
        if self.trials < 1:
            raise ConfigurationError("No trial.", got=self.trials, allowed="1 or more", hint="--trials 1")
        if not 0 <= self.seed <= MAX_SEED + 1 - self.episodes:
            allowed = f"0 or more, all seeds up to {MAX_SEED}"
            raise ConfigurationError("Not a first seed.", got=self.seed, allowed=allowed, hint="--seed 1000")
        if self.episode_log.exists():
            from lerobot_adamanip.datasets.opening import as_typed

            raise ConfigurationError(
                "The log exists.", got=self.episode_log, allowed="a new file", hint=f"rm {as_typed(self.episode_log)}"
            )
        same = ("category", "objects", "split", "poses", "mechanism_rules", "max_failed_tries", "repeats", "sensing")
        options = EnvironmentOptions(
            **{name: getattr(self, name) for name in (*same, "hints")},
            max_key_frames=self.episode_length,
            observe_images=False,
            episode_log=str(self.episode_log),
            run_label=f"{self.expert} expert",
        )
        from lerobot_adamanip.evaluation.report import compare

        comparison = compare({"expert": list(self._episodes(options))})
        text = "\n".join(
            (comparison.title, "", comparison.table(), "", *comparison.lines(), f"written: {self.episode_log}")
        )
        print_result(self.json, {**comparison.to_json(), "episode_log": self.episode_log}, text)
        return 0

    def _episodes(self, options: EnvironmentOptions) -> Iterator[EpisodeRecord]:
        from lerobot_adamanip.evaluation.record import EpisodeRecord
        from lerobot_env_adamanip.make_environment import make_environment

        env = make_environment(options)
        try:
            with show_progress({"episodes": "episodes"}) as progress:
                for number in range(self.episodes):
                    progress("episodes", number, self.episodes)
                    self._episode(env, self.seed + number)
                    yield EpisodeRecord.from_json(env.episode_record())
                progress("episodes", self.episodes, self.episodes)
        finally:
            env.close()

    def _episode(self, env: SimulatedEnvironment, seed: int) -> None:
        """Runs an episode to its end: if the expert gives up, its last goal is repeated until a limit is reached."""
        from lerobot_adamanip.episode.rollout import KeyFrame, rollout
        from lerobot_adamanip.experts import make_expert

        observation, _ = env.reset(seed=seed)
        expert = make_expert(
            self.category,
            self.expert,
            env.annotations,
            generator=episode_generator(seed, Stream.EXPERT, self.category),
            trials=self.trials,
            hidden=env.hidden_state() if self.expert == "static" else None,
            strategy=self.expert_strategy,
            mechanism_rules=self.mechanism_rules,
        )
        sent: list[KeyFrame] = []
        rollout(env, observation, expert, sent.append)
        while not any(env.drive(sent[-1].goal.action())):
            pass
