"""Options in the commands of a benchmark, and their names in `adamanip expert`, which evaluates experts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

_TYPE, _PREFIX = "--env.type", "adamanip_"
_OPTIONS = {
    _TYPE: "--category",
    "--seed": "--seed",
    "--eval.n_episodes": "--episodes",
    **{
        f"--env.{name}": f"--{name.replace('_', '-')}"
        for name in (
            "objects", "split", "poses", "mechanism_rules", "episode_length", "max_failed_tries", "episode_log"
        )
    },
}  # fmt: skip
"""Option of `lerobot-eval` -> option of `adamanip expert`, which has no others of an environment."""


def expert_command(expert: Iterable[str], evaluation: Iterable[str]) -> list[str]:
    """Returns the command that evaluates an expert as ``evaluation`` does a policy.

    Args:
        expert: options of `adamanip expert` that select the expert.
        evaluation: options of `lerobot-eval`; those of policies, observations and batches are left out.
    """
    pairs = (option.partition("=") for option in evaluation)
    given = {_OPTIONS[name]: value.removeprefix(_PREFIX) for name, _, value in pairs if name in _OPTIONS}
    return ["adamanip", "expert", *expert, *(f"{name}={value}" for name, value in given.items())]


def options_of(command: Iterable[str]) -> dict[str, str]:
    """Returns the options of a command, name -> value."""
    return {name: value for name, _, value in (word.partition("=") for word in command)}


def evaluation_options(command: Sequence[str]) -> dict[str, str]:
    """Returns the options of an evaluation by their names in `lerobot-eval`, name -> value."""
    given = options_of(command)
    if list(command[:2]) != ["adamanip", "expert"]:
        return given
    found = {name: given[own] for name, own in _OPTIONS.items() if own in given}
    return {**found, _TYPE: f"{_PREFIX}{found[_TYPE]}"}


def option(command: Iterable[str], name: str) -> str:
    """Returns the value of ``--NAME=VALUE`` in a command that contains it."""
    (value,) = (word.partition("=")[2] for word in command if word.partition("=")[0] == name)
    return value


def with_options(command: str, *options: str) -> list[str]:
    """Returns a command with each option once; the last value of an option wins."""
    return [command, *{option.partition("=")[0]: option for option in options}.values()]
