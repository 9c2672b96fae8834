"""The `adamanip` command: lazy subcommands, one-message errors, exit statuses."""

from __future__ import annotations

import errno
import math
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from lerobot_adamanip import __version__
from lerobot_adamanip.cli import main as cli
from lerobot_adamanip.cli.arguments import print_result
from lerobot_adamanip.util.errors import INSTALL_SIM, DatasetError


@dataclass
class Probe:
    """A command for these tests."""

    status: int = 0
    fail: str = ""

    def run(self) -> int:
        if self.fail == "dataset":
            raise DatasetError("half written")
        if self.fail == "path":
            raise NotADirectoryError(20, "Not a directory", "some/file/x")
        if self.fail == "disk":
            raise OSError(errno.ENOSPC, "No space left on device")
        if self.fail == "socket":
            raise OSError(98, "Address already in use")
        if self.fail == "interrupt":
            raise KeyboardInterrupt
        if self.fail == "simulator":
            raise ModuleNotFoundError("No module named 'mani_skill'", name="mani_skill.envs")
        if self.fail == "bug":
            raise ModuleNotFoundError("No module named 'typo'", name="typo")
        return self.status


@pytest.fixture(autouse=True)
def _probe_command(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("lerobot_adamanip.cli.probe")
    module.Probe = Probe  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(cli.COMMANDS, "probe", cli.CommandEntry("probe:Probe", "a probe"))
    monkeypatch.setitem(cli.COMMANDS, "absent", cli.CommandEntry("no_such_module:Absent", "not there"))


def test_json_has_no_number_that_is_none(capsys: pytest.CaptureFixture[str]) -> None:
    print_result(True, {"a": math.nan, "b": [math.inf, 1.0], "c": {"d": (np.float64("nan"),)}, "e": Path("x")}, "")
    assert capsys.readouterr().out == '{"a": null, "b": [null, 1.0], "c": {"d": [null]}, "e": "x"}\n'


@pytest.mark.parametrize(
    ("arguments", "status", "out", "err"),
    [
        (["--help"], 0, "benchmark", ""),
        ([], 2, "usage", ""),
        (["--version"], 0, f"adamanip {__version__}\n", ""),
        (["probe"], 0, "", ""),
        (["probe", "--status", "7"], 7, "", ""),
        (["probe", "--fail", "dataset"], 2, "", "error: half written\n"),
        (["probe", "--fail", "path"], 2, "", "some/file/x: Not a directory\n  allowed:"),
        (["probe", "--fail", "disk"], 2, "", "error: No space is left on the disk.\n  got:"),
        (["probe", "--fail", "interrupt"], 130, "", "interrupted\n"),
        (["probe", "--fail", "simulator"], 2, "", INSTALL_SIM),
        (["absent"], 2, "", "no_such_module"),
    ],
)
def test_exit_status_and_message(
    arguments: list[str], status: int, out: str, err: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(arguments) == status
    printed = capsys.readouterr()
    for text, stream in ((out, printed.out), (err, printed.err)):
        assert text in stream
        assert bool(text) == bool(stream)


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("option", ["--help", "--version"])
def test_a_pipe_that_its_reader_has_closed_is_no_traceback(option: str, unbuffered: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "lerobot_adamanip.cli.main", option]
    environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, env=environment, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (cli.EXIT_ERROR, "")


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_output_onto_a_full_disk_is_one_error(unbuffered: str) -> None:
    command = [sys.executable, "-m", "lerobot_adamanip.cli.main", "--version"]
    environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, env=environment, check=False)
    assert done.returncode == cli.EXIT_ERROR
    assert done.stderr.startswith("error: No space is left on the disk.")
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr


def test_help_lists_every_command() -> None:
    assert all(f"  {name} " in cli.usage() for name in cli.COMMANDS)


def test_our_own_mistakes_keep_their_traceback() -> None:
    with pytest.raises(ModuleNotFoundError, match="typo"):
        cli.main(["probe", "--fail", "bug"])
    with pytest.raises(OSError, match="Address"):
        cli.main(["probe", "--fail", "socket"])
