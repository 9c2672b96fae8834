"""The `adamanip` command: finds the subcommand, parses its options, runs it, and turns errors into one message."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, cast

import lerobot_adamanip
from lerobot_adamanip import NO_PLUGIN
from lerobot_adamanip.cli.option_names import check_options
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError, SimulatorError, listed, nearest

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130
_WITHOUT_PLUGIN = (
    "collect",
    "render",
    "replay",
    "merge",
    "keyframes",
    "filter",
    "split",
    "view",
    "check",
    "repair",
    "stats",
    "push",
)
"""Commands to which our environments and policy are no plugin of LeRobot: registering them takes each process 3 s."""
_SIMULATOR_PACKAGES = frozenset({"mani_skill", "sapien", "cv2"})


class Entry(NamedTuple):
    """Where a subcommand lives (imported when it is called, not before) and what it does."""

    target: str  # "module:Class", the class a dataclass whose fields are the options
    help: str


COMMANDS = {
    "doctor": Entry("lerobot_adamanip.cli.doctor:Doctor", "check the installation and the renderer, and print fixes"),
    "collect": Entry("lerobot_adamanip.cli.collect:Collect", "record demonstrations of an expert as a LeRobotDataset"),
    "replay": Entry("lerobot_adamanip.cli.replay:Replay", "replay a recorded episode in the simulator and compare"),
    "render": Entry("lerobot_adamanip.cli.render:Render", "add pictures to a dataset that was collected without them"),
    "check": Entry("lerobot_adamanip.cli.check:Check", "check a dataset, and repair it after a crash"),
    "repair": Entry("lerobot_adamanip.cli.check:Repair", "repair a dataset or a recording after a crash"),
    "keyframes": Entry(
        "lerobot_adamanip.cli.keyframes:Keyframes", "make demonstrations of a robot's recordings, alone or in a mix"
    ),
    "stats": Entry(
        "lerobot_adamanip.cli.stats:Stats", "count what is in a dataset: episodes, tries, lengths, hidden values"
    ),
    "merge": Entry("lerobot_adamanip.cli.merge:Merge", "write one dataset with the episodes of several"),
    "filter": Entry("lerobot_adamanip.cli.filter:Filter", "write a dataset with the episodes that fulfil conditions"),
    "split": Entry("lerobot_adamanip.cli.split:Split", "write a dataset as several, by shares or by what is known"),
    "view": Entry("lerobot_adamanip.cli.view:View", "look at an episode: cloud, tool path, goals, tries, effort"),
    "push": Entry(
        "lerobot_adamanip.cli.push:Push", "publish a dataset, a policy or the environments on the Hugging Face Hub"
    ),
    "objects": Entry(
        "lerobot_adamanip.cli.objects.command:Objects", "draw a contact sheet of the objects of a category"
    ),
    "annotate": Entry(
        "lerobot_adamanip.cli.annotate.command:Annotate",
        "annotate the grasps and joints of external assets in the browser",
    ),
    "calibrate": Entry(
        "lerobot_adamanip.cli.calibrate:Calibrate", "find where a camera is, by a board that the arm shows it"
    ),
    "report": Entry(
        "lerobot_adamanip.cli.report:Report", "success rates with intervals, trials and plots of an evaluation"
    ),
    "benchmark": Entry(
        "lerobot_adamanip.cli.benchmark:Benchmark", "train and test methods side by side, beside the paper's table"
    ),
    "bench": Entry(
        "lerobot_adamanip.cli.bench:Bench", "measure collection, simulation, observation, training and action"
    ),
}


class Command(Protocol):
    """A subcommand: a dataclass of options."""

    def run(self) -> int:
        """Does the work; returns the exit status."""


def usage() -> str:
    """The text of `adamanip --help`; imports no subcommand."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {entry.help}" for name, entry in COMMANDS.items()]
    return "\n".join(
        [
            "usage: adamanip [-h] [--version] COMMAND [OPTIONS]",
            "",
            "commands:",
            *lines,
            "",
            "`adamanip COMMAND --help` lists the options.",
        ]
    )


def load(name: str) -> type[Command]:
    """The class of a subcommand.

    Raises:
        ConfigurationError: there is no such subcommand, or a package it needs is not installed.
        SimulatorError: the simulator is not installed.
    """
    if name not in COMMANDS:
        near = nearest(name, COMMANDS)
        hint = f"adamanip {near}" if near else "adamanip --help"
        raise ConfigurationError("Unknown command.", got=repr(name), allowed=listed(list(COMMANDS)), hint=hint)
    module, _, attribute = COMMANDS[name].target.partition(":")
    try:
        return cast(type[Command], getattr(importlib.import_module(module), attribute))
    except ModuleNotFoundError as error:
        raise _missing(name, error.name or str(error)) from error


def _missing(command: str, package: str) -> AdaManipError:
    """The error for a package that is not installed, by what installs it."""
    root = package.partition(".")[0]
    what = f"`adamanip {command}` needs a package that is not installed."
    if root in _SIMULATOR_PACKAGES:
        advice = "pip install 'lerobot_env_adamanip[sim]'"
        return SimulatorError(what, got=f"no module {package}", allowed="the simulator's packages", hint=advice)
    advice = "install the project again; `adamanip doctor` shows what is missing"
    return ConfigurationError(what, got=f"no module {package}", allowed="a complete installation", hint=advice)


def parse(name: str, options: Sequence[str]) -> Any:
    """Returns a subcommand with its options, ready to run; exits, or raises `ConfigurationError`, for wrong ones."""
    command = load(name)
    check_options(name, command, options)
    import tyro

    config = (tyro.conf.FlagCreatePairsOff,)
    return tyro.cli(command, prog=f"adamanip {name}", description=command.__doc__, args=options, config=config)


def execute(name: str, options: Sequence[str]) -> int:
    """Parses the options of one subcommand and runs it; returns its exit status."""
    chosen = parse(name, options)
    try:
        return chosen.run()  # type: ignore[no-any-return]
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in _SIMULATOR_PACKAGES:
            raise  # a mistake of ours: the traceback is what helps
        raise _missing(name, str(error.name)) from error


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; exit status 0 done, 1 the command's own verdict, 2 an error of use or set-up, 130 interrupted."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    policy = any(each.startswith("--policy") for each in arguments)  # which is a plugin's
    if argv is None and arguments and arguments[0] in _WITHOUT_PLUGIN and not policy:
        os.environ[NO_PLUGIN] = "1"
    if not arguments or arguments[0] in ("-h", "--help"):
        print(usage())
        return 0 if arguments else EXIT_ERROR
    if arguments[0] == "--version":
        print(f"adamanip {lerobot_adamanip.__version__}")
        return 0
    try:
        return execute(arguments[0], arguments[1:])
    except AdaManipError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_ERROR
    except BrokenPipeError:
        # Whoever read it, `head` for instance, has seen enough; closing the stream at exit shall not complain again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_ERROR
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
