"""Errors say what went wrong, what was given, what is allowed and what to try, and can be caught as one kind."""

from __future__ import annotations

import inspect

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_adamanip.util import errors
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError, require_choice

KINDS = [kind for _, kind in inspect.getmembers(errors, inspect.isclass) if issubclass(kind, Exception)]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_error_is_of_the_project_s_family(kind: type[Exception]) -> None:
    assert issubclass(kind, AdaManipError)
    assert inspect.getdoc(kind)


@pytest.mark.parametrize(
    ("name", "builtin"),
    [
        ("ConfigurationError", ValueError), ("DatasetError", RuntimeError), ("SimulatorError", RuntimeError),
        ("UnreachableError", RuntimeError),
    ],
)  # fmt: skip
def test_who_does_not_know_the_project_catches_python_s_own_kinds(name: str, builtin: type[Exception]) -> None:
    with pytest.raises(builtin, match="no luck"):
        raise getattr(errors, name)("no luck")


def test_an_explanation_carries_its_four_facts_in_order() -> None:
    first, got, allowed, advice = str(AdaManipError("It broke.", got=3, allowed="1 or 2", hint="two")).splitlines()
    assert first == "It broke."
    assert [line.split() for line in (got, allowed, advice)] == [
        ["got:", "3"],
        ["allowed:", "1", "or", "2"],
        ["try:", "two"],
    ]


@given(st.lists(st.text(min_size=1), min_size=1, unique=True), st.data())
@settings(max_examples=40, deadline=None)
def test_a_choice_is_returned_as_it_is(choices: list[str], data: st.DataObject) -> None:
    chosen = data.draw(st.sampled_from(choices))
    assert require_choice("colour", chosen, iter(choices)) == chosen


@pytest.mark.parametrize("got", ["", "Red", " red", "gre", "red, green"])
def test_no_choice_is_refused_with_all_that_are(got: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        require_choice("colour", got, ["red", "green"])
    message = str(caught.value)
    assert message.startswith("Unknown colour.")
    assert repr(got) in message
    assert "green, red" in message


def test_a_caller_may_know_better_what_to_try() -> None:
    with pytest.raises(ConfigurationError, match=r"try: +--colour red"):
        require_choice("colour", "blue", ["red"], hint="--colour red")
