"""Errors say what went wrong, what was given, what is allowed and what to try, and can be caught as one kind."""

from __future__ import annotations

import inspect

import pytest

from lerobot_adamanip.util import errors
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError, require_choice

KINDS = [kind for _, kind in inspect.getmembers(errors, inspect.isclass) if issubclass(kind, Exception)]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_error_is_of_the_project_s_family_and_of_a_kind_of_python_s(kind: type[Exception]) -> None:
    assert issubclass(kind, AdaManipError)
    assert kind is AdaManipError or issubclass(kind, ValueError if kind is ConfigurationError else RuntimeError)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_an_error_of_an_error_says_the_same(kind: type[AdaManipError]) -> None:
    """As Gymnasium raises the error of a worker process."""
    first = kind("It broke.", got=3, allowed="1 or 2", hint="two")
    assert str(kind(first)) == str(first)  # type: ignore[arg-type,unused-ignore]


def test_an_explanation_carries_its_four_facts_in_order() -> None:
    first, got, allowed, advice = str(AdaManipError("It broke.", got=3, allowed="1 or 2", hint="two")).splitlines()
    assert first == "It broke."
    assert [line.split() for line in (got, allowed, advice)] == [
        ["got:", "3"],
        ["allowed:", "1", "or", "2"],
        ["try:", "two"],
    ]


@pytest.mark.parametrize("got", ["", "Red", " red", "gre", "red, green"])
def test_no_choice_is_refused_with_all_that_are(got: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        require_choice("colour", got, ["red", "green"])
    assert require_choice("colour", "red", iter(["red", "green"])) == "red"
    message = str(caught.value)
    assert message.startswith("Unknown colour.")
    assert repr(got) in message
    assert "green, red" in message


def test_a_caller_may_know_better_what_to_try() -> None:
    with pytest.raises(ConfigurationError, match=r"try: +--colour red"):
        require_choice("colour", "blue", ["red"], hint="--colour red")
