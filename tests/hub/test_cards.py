"""The dataset card: complete, true of the data, and free of what belongs to a machine."""

from __future__ import annotations

import getpass
import json
import socket
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml
from demos_helpers import make_spec

from lerobot_adamanip import schema
from lerobot_adamanip.cli.collect import Collect
from lerobot_adamanip.demos.card import COLUMNS
from lerobot_adamanip.errors import ConfigurationError
from lerobot_adamanip.fingerprint import combined
from lerobot_adamanip.hub import cards


@pytest.fixture
def card(published: Path) -> str:
    return (published / "README.md").read_text()


def test_its_front_matter_is_what_the_hub_reads(card: str) -> None:
    front_matter = yaml.safe_load(card.split("---")[1])
    assert front_matter["license"] == "apache-2.0"
    assert "LeRobot" in front_matter["tags"]
    assert "$" not in card


def test_every_column_is_described(card: str) -> None:
    for key in schema.dataset_features():
        assert f"| `{key}` |" in card
    assert set(COLUMNS) == set(schema.dataset_features())


def test_its_numbers_are_those_of_the_dataset(published: Path, card: str) -> None:
    attempts = [json.loads(line) for line in (published / "meta" / "attempts.jsonl").read_text().splitlines()]
    kept = sum(attempt["kept"] for attempt in attempts)
    assert f"{len(attempts)} episodes were attempted, of which {kept} " in card
    for locked in (True, False):
        mine = [attempt for attempt in attempts if (attempt["hidden_state"] or {}).get("locked") is locked]
        row = f"| `locked = {json.dumps(locked)}` | {sum(each['kept'] for each in mine)} | {len(mine)} |"
        assert row in card
    unplaced = sum(attempt["hidden_state"] is None for attempt in attempts)
    assert f"| `(no layout)` | 0 | {unplaced} |" in card
    late = sum(pq.read_table(published / "meta/episodes/chunk-000/file-000.parquet")["late"].to_pylist())
    assert f"{late} episodes start late" in card
    assert combined({"fake": "1", "code": "a"}) in card
    assert "| code | `a` |" in card


def test_its_command_collects_the_same(card: str) -> None:
    import tyro

    (line,) = [line for line in card.splitlines() if line.startswith("adamanip collect")]
    assert line.endswith("--root dataset")
    asked = tyro.cli(Collect, args=line.split()[2:]).spec()
    assert (asked.objects, asked.seed, asked.late_starts) == (make_spec().objects, 0, make_spec().late_starts)
    assert asked.episodes_per_object == make_spec().episodes_per_object


def test_nothing_of_this_machine_is_published(published: Path) -> None:
    secrets = [str(published), str(Path.home()), "/tmp", socket.gethostname(), str(Path.cwd())]
    secrets = [secret for secret in (*secrets, f"/{getpass.getuser()}/") if len(secret) > 3]  # not by chance
    for path in published.rglob("*"):
        if path.is_file():
            content = path.read_bytes()
            assert not [secret for secret in secrets if secret.encode() in content], path


def test_templates_are_found_in_a_checkout_and_in_a_wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_checkout = cards.card_template("dataset_card.md").template
    package = tmp_path / "lerobot_adamanip"
    (package / "hub_cards").mkdir(parents=True)
    (package / "hub_cards" / "dataset_card.md").write_text("wheel")
    monkeypatch.setattr(cards.importlib.resources, "files", lambda name: package)
    assert cards.card_template("dataset_card.md").template == "wheel" != in_checkout
    with pytest.raises(ConfigurationError, match="template"):
        cards.card_template("nothing.md")
