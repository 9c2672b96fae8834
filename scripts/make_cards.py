"""Writes docs/cards: ``python scripts/make_cards.py [--demo outputs/demo] [--only environment]``.

The cards and their checks are those of `adamanip push`. The environments' card depends on results/experts.json. The
dataset's and the model's card need the output of `make demo`.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

from lerobot_adamanip.hub.model_index import read_results
from lerobot_adamanip.hub.staging import Staged, stage_dataset, stage_environment, stage_model

ROOT = Path(__file__).resolve().parents[1]
CARDS = ROOT / "docs" / "cards"
DATASET, MODEL, ENVIRONMENT = "USER/adamanip-safe", "USER/dp3-safe", "USER/adamanip"
"""Repository names in the cards' commands."""
RESULTS, EXPERTS = ROOT / "results" / "demo.json", ROOT / "results" / "experts.json"


def environment(into: Path) -> Staged:
    """Stages the environments' repository with the experts' results."""
    return stage_environment(ENVIRONMENT, into, results=read_results([EXPERTS]))


def as_sample(card: str) -> str:
    """Returns the card with the heading marked as a sample."""
    return card.replace("\n# ", "\n# Sample card: ", 1)


def main() -> None:
    """Writes the three cards."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--demo", type=Path, default=ROOT / "outputs" / "demo", help="folder of `make demo`")
    parser.add_argument("--only", choices=("dataset", "model", "environment"), help="write only this card")
    options = parser.parse_args()
    demo = options.demo
    policy = demo / "train" / "checkpoints" / "last"
    staged: dict[str, Callable[[Path], Staged]] = {
        "dataset": lambda into: stage_dataset(demo / "demos", DATASET, into),
        "model": lambda into: stage_model(policy, MODEL, into, results=read_results([RESULTS]), dataset=DATASET),
        "environment": environment,
    }
    CARDS.mkdir(exist_ok=True)
    for name, stage in staged.items() if options.only is None else [(options.only, staged[options.only])]:
        with tempfile.TemporaryDirectory() as scratch:
            card = stage(Path(scratch)).folder / "README.md"
            (CARDS / f"{name}.md").write_text(as_sample(card.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
