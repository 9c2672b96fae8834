"""Versions of results: which differ, and what a reader is told."""

from __future__ import annotations

import pytest

from lerobot_adamanip.contract.versions import (
    DATA_VERSION,
    SIMULATION_VERSION,
    earlier_version,
    installed_versions,
    joined_versions,
    mixed_versions,
    software_versions,
)
from lerobot_adamanip.datasets import cards
from lerobot_adamanip.hub import environment
from lerobot_adamanip.hub.model_card import Checkpoint, model_card


def test_versions_that_differ_are_named_once() -> None:
    one, other = {"torch": "2.10.0", "numpy": "2.0"}, {"torch": "2.11.0", "numpy": "2.0"}
    assert mixed_versions([one, other, one]) == "torch 2.10.0 and 2.11.0"
    assert mixed_versions([one, one]) == mixed_versions([]) == ""
    assert mixed_versions([one, {"lerobot": "0.6.1"}]) == "", "what is not known does not differ"
    assert mixed_versions([joined_versions([one, other]), one]) == "torch 2.10.0 and 2.11.0"


def test_only_other_simulation_versions_are_told() -> None:
    assert earlier_version([]) == earlier_version([SIMULATION_VERSION]) == ""
    one, several = earlier_version([1]), earlier_version([SIMULATION_VERSION, 1, 1])
    assert one == f"Measured with simulation version 1; the present one is {SIMULATION_VERSION}."
    assert several == f"Measured with simulation versions 1 and {SIMULATION_VERSION}; the present one is 3."


def test_all_software_behind_a_row_has_a_version() -> None:
    versions = software_versions()
    assert (versions["simulation"], versions["data"]) == (str(SIMULATION_VERSION), str(DATA_VERSION))
    assert {"python", "lerobot", "torch", "numpy", "gymnasium"} <= installed_versions().keys() < versions.keys()


@pytest.mark.parametrize(
    ("version", "requirement", "install"),
    [
        ("0.3.0", "==0.3.0", "pip install 'lerobot_env_adamanip[sim]==0.3.0'"),
        (
            "0.3.0.dev0",
            ">=0.3.0.dev0",
            "0.3.0.dev0 is no release: in a checkout of its repository at commit cccccccccc",
        ),
    ],
)
def test_cards_ask_for_what_can_be_installed(
    monkeypatch: pytest.MonkeyPatch, version: str, requirement: str, install: str
) -> None:
    monkeypatch.setattr(cards, "__version__", version)
    files = environment.environment_files("someone/adamanip", commit="c" * 40)
    *comments, line = files["requirements.txt"].splitlines()
    assert line == f"lerobot_env_adamanip[sim]{requirement}"
    assert f"# {install}" in comments
    assert install.partition(" at commit")[0] in model_card(Checkpoint({"type": "act"}, {}, 1), "someone/policy")
    for text in cards.template_texts():
        assert "pip install 'lerobot_env" not in text
        assert "pip install lerobot_env" not in text
    assert install in files["README.md"]
    for name in ("env.py", "envs/safe.py"):
        compile(files[name], name, "exec")
        assert install in files[name]
    assert f"simulation version {SIMULATION_VERSION}." in files["README.md"]
