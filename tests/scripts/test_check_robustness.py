"""The check with nonsense: what it sums up, says of itself and refuses. The check itself: tests/envs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import pytest
from check_robustness import main

from lerobot_adamanip.contract.categories import CATEGORIES


def fake(wrong: Sequence[str] = ()) -> Any:
    def run(names: Sequence[str], seeds: list[int], workers: int) -> list[dict[str, Any]]:
        return [{"category": name, "seeds": len(seeds), "unplaced": 1, "wrong": list(wrong)} for name in names]

    return run


def test_what_went_wrong_is_printed_and_fails(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--category", "lamp", "--seeds", "3"], fake()) == 0
    assert capsys.readouterr().out.split() == ["lamp", "3", "seeds,", "1", "not", "placed,", "0", "wrong"]
    assert main(["--category", "lamp"], fake(["seed 1: not finite"])) == 1
    assert "seed 1: not finite" in capsys.readouterr().out


def test_the_json_says_what_made_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--json", "--seeds", "2", "--first-seed", "9"], fake()) == 0
    said = json.loads(capsys.readouterr().out)
    assert [row["category"] for row in said["results"]] == list(CATEGORIES)
    assert {"command", "commit", "fingerprint", "versions"} <= set(said)
    assert said["first_seed"] == 9


@pytest.mark.parametrize("arguments", [["--seeds", "0"], ["--workers", "0"], ["--category", "fridge"]])
def test_a_wrong_option_is_refused(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments, fake())
    assert caught.value.code == 2
