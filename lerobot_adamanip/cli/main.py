"""The `adamanip` command: loads a subcommand, parses its options, runs it, and prints errors as one message."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, cast

import lerobot_adamanip
from lerobot_adamanip import NO_PLUGIN
from lerobot_adamanip.cli.option_names import check_options, in_own_words, unreadable_options
from lerobot_adamanip.util.account import require_account
from lerobot_adamanip.util.errors import INSTALL_SIM, AdaManipError, ConfigurationError, SimulatorError, listed, nearest
from lerobot_adamanip.util.files import full_disk_error

EXIT_ERROR, EXIT_INTERRUPTED = 2, 130
_USES_PLUGIN = ("doctor", "objects", "annotate", "calibrate", "report", "benchmark")
"""Commands that load our environments and policies as LeRobot plugins. The others start 3 s faster."""
_SIMULATOR_PACKAGES = frozenset({"mani_skill", "sapien", "cv2"})


class CommandEntry(NamedTuple):
    """A subcommand: a class of `lerobot_adamanip.cli`, imported on call, and its help text.

    Attributes:
        target: "module:Class". The class is a dataclass whose fields are the options.
        help: one line of help.
    """

    target: str
    help: str


FIRST_COMMANDS = {
    "doctor": CommandEntry("doctor:DoctorCommand", "check the installation and the renderer, and print fixes"),
    "collect": CommandEntry("collect:CollectCommand", "record demonstrations of an expert as a LeRobotDataset"),
    "check": CommandEntry("check:CheckCommand", "check a dataset, and repair it after a crash"),
    "keyframes": CommandEntry("keyframes:KeyframesCommand", "convert robot recordings to demonstrations"),
    "report": CommandEntry(
        "report:ReportCommand", "report success rates with intervals, tries and plots of an evaluation"
    ),
    "push": CommandEntry("push:PushCommand", "publish a dataset, a policy or the environments on the Hugging Face Hub"),
    "benchmark": CommandEntry(
        "benchmark:BenchmarkCommand", "train and evaluate methods, and compare them with the paper"
    ),
}
COMMANDS = FIRST_COMMANDS | {
    "stats": CommandEntry("stats:StatsCommand", "count episodes, tries, lengths and hidden values of a dataset"),
    "view": CommandEntry("view:ViewCommand", "show an episode: cloud, tool path, goals, tries, effort"),
    "replay": CommandEntry("replay:ReplayCommand", "replay a recorded episode in the simulator and compare"),
    "render": CommandEntry("render:RenderCommand", "add pictures to a dataset that was collected without them"),
    "memory": CommandEntry("memory:MemoryCommand", "add a memory of felt tries to a dataset"),
    "merge": CommandEntry("edit:MergeCommand", "merge datasets into a new one"),
    "filter": CommandEntry("edit:FilterCommand", "write a dataset with the episodes that fulfil conditions"),
    "split": CommandEntry("edit:SplitCommand", "split a dataset into several, by shares or by values"),
    "expert": CommandEntry("expert:ExpertCommand", "evaluate an expert in the scenes in which policies are evaluated"),
    "objects": CommandEntry("objects:ObjectsCommand", "draw a contact sheet of the objects of a category"),
    "annotate": CommandEntry(
        "annotate.command:AnnotateCommand", "annotate grasps and joints of external assets in the browser"
    ),
    "calibrate": CommandEntry("calibrate:CalibrateCommand", "calibrate a camera's pose with a board and the arm"),
}


class Command(Protocol):
    """A subcommand: a dataclass of options."""

    def run(self) -> int:
        """Runs the command and returns the exit status."""


def usage() -> str:
    """Returns the text of `adamanip --help`. Imports no subcommand."""
    width = max(map(len, COMMANDS))
    first = [f"  {name:<{width}}  {entry.help}" for name, entry in FIRST_COMMANDS.items()]
    others = [f"  {name:<{width}}  {COMMANDS[name].help}" for name in COMMANDS if name not in FIRST_COMMANDS]
    head = ["usage: adamanip [-h] [--version] COMMAND [OPTIONS]", "", "commands:"]
    tail = ["", "`adamanip COMMAND --help` lists the options."]
    return "\n".join([*head, *first, "", "further commands:", *others, *tail])


def load(name: str) -> type[Command]:
    """Returns the class of a subcommand.

    Raises:
        ConfigurationError: the subcommand is unknown, or a required package is not installed.
        SimulatorError: the simulator is not installed.
    """
    if name not in COMMANDS:
        near = nearest(name, COMMANDS)
        hint = f"adamanip {near}" if near else "adamanip --help"
        raise ConfigurationError("Unknown command.", got=repr(name), allowed=listed(list(COMMANDS)), hint=hint)
    module, _, attribute = COMMANDS[name].target.partition(":")
    try:
        return cast(type[Command], getattr(importlib.import_module(f"lerobot_adamanip.cli.{module}"), attribute))
    except ModuleNotFoundError as error:
        raise _missing_package(name, error) from error


def _missing_package(command: str, error: ModuleNotFoundError) -> AdaManipError:
    package = error.name or str(error)
    what, got = f"`adamanip {command}` needs a package that is not installed.", f"no module {package}"
    if package.partition(".")[0] in _SIMULATOR_PACKAGES:
        return SimulatorError(what, got=got, allowed="the simulator's packages", hint=INSTALL_SIM)
    hint = "install the project again; `adamanip doctor` shows what is missing"
    return ConfigurationError(what, got=got, allowed="a complete installation", hint=hint)


def parse_command(name: str, options: Sequence[str]) -> Any:
    """Returns a subcommand with its options. Exits after ``--help``; raises `ConfigurationError` for wrong options."""
    command = load(name)
    check_options(name, command, options)
    import tyro

    config, output = (tyro.conf.FlagCreatePairsOff,), io.StringIO()
    try:
        with contextlib.redirect_stderr(output):
            return tyro.cli(command, prog=f"adamanip {name}", description=command.__doc__, args=options, config=config)
    except SystemExit as ended:
        if not ended.code:
            raise
        raise unreadable_options(name, output.getvalue()) from None


def execute(name: str, options: Sequence[str]) -> int:
    """Parses the options of a subcommand, runs it, and returns its exit status."""
    command = parse_command(name, options)
    if name != "doctor":  # which reports it as a check
        require_account()
    try:
        return command.run()  # type: ignore[no-any-return]
    except AdaManipError as error:
        error.args = (in_own_words(str(error), command),)
        raise
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in _SIMULATOR_PACKAGES:
            raise  # a bug in our code: the traceback helps
        raise _missing_package(name, error) from error


def _answer(arguments: Sequence[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        print(usage())
        return 0 if arguments else EXIT_ERROR
    if arguments[0] == "--version":
        print(f"adamanip {lerobot_adamanip.__version__}")
        return 0
    return execute(arguments[0], arguments[1:])


def _discard_output() -> None:
    """Drops output that cannot be written, so that Python does not raise again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of the `adamanip` command.

    Returns:
        0 on success, 1 for a negative result of the command, 2 for a usage or setup error, 130 if interrupted.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    loads_policy = any(each.startswith("--policy") for each in arguments)
    if argv is None and arguments and arguments[0] not in _USES_PLUGIN and not loads_policy:
        os.environ[NO_PLUGIN] = "1"
    try:
        status = _answer(arguments)
        sys.stdout.flush()  # a pipe that its reader has closed is an error here, not at exit
        return status
    except AdaManipError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_ERROR
    except BrokenPipeError:
        _discard_output()  # the reader, e.g. `head`, has closed the pipe
        return EXIT_ERROR
    except OSError as error:
        refusal = full_disk_error(error, [*(each.rpartition("=")[2] for each in arguments), "."])
        if refusal is None and error.filename is None:
            raise  # of no file that a user has named: the traceback helps
        refusal = refusal or ConfigurationError(
            "A file or folder cannot be used.",
            got=f"{error.filename}: {error.strerror}",
            allowed="a path that can be read or written, as the command needs",
            hint="another path",
        )
        print(f"error: {refusal}", file=sys.stderr)
        try:
            sys.stdout.flush()
        except OSError:  # a full disk
            _discard_output()
        return EXIT_ERROR
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
