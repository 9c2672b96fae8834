"""The `adamanip` command: lazy subcommands, one-message errors, exit statuses."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from types import ModuleType

import pytest

from lerobot_adamanip import __version__
from lerobot_adamanip.cli import main as cli
from lerobot_adamanip.util.errors import DatasetError


@dataclass
class Probe:
    """A command for these tests."""

    status: int = 0
    fail: str = ""

    def run(self) -> int:
        if self.fail == "dataset":
            raise DatasetError("half written")
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
    monkeypatch.setitem(cli.COMMANDS, "probe", cli.Entry("probe:Probe", "a probe"))
    monkeypatch.setitem(cli.COMMANDS, "absent", cli.Entry("no_such_module:Absent", "not there"))


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in cli.COMMANDS)


def test_no_arguments_is_a_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 2
    assert "usage" in capsys.readouterr().out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"adamanip {__version__}"


@pytest.mark.parametrize("status", [0, 1, 7])
def test_exit_status_is_the_commands(status: int) -> None:
    assert cli.main(["probe", "--status", str(status)]) == status


def test_expected_errors_are_one_message(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["probe", "--fail", "dataset"]) == 2
    printed = capsys.readouterr()
    assert printed.err == "error: half written\n"
    assert printed.out == ""


def test_interrupt_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["probe", "--fail", "interrupt"]) == 130
    assert capsys.readouterr().err.count("\n") == 1


def test_missing_simulator_names_the_extra(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["probe", "--fail", "simulator"]) == 2
    assert "lerobot_env_adamanip[sim]" in capsys.readouterr().err


def test_our_own_mistakes_keep_their_traceback() -> None:
    with pytest.raises(ModuleNotFoundError, match="typo"):
        cli.main(["probe", "--fail", "bug"])


def test_unknown_command_lists_the_known_and_guesses(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["docter"]) == 2
    printed = capsys.readouterr().err
    assert "collect" in printed
    assert "try:     adamanip doctor" in printed


def test_a_missing_module_harms_only_its_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["absent"]) == 2
    assert "no_such_module" in capsys.readouterr().err
    assert cli.main(["probe"]) == 0


@pytest.mark.usefixtures("no_vulkan")
@pytest.mark.parametrize("name", sorted(cli.COMMANDS))
def test_every_command_of_the_table_loads_and_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        cli.main([name, "--help"])
    assert exit_.value.code == 0
    assert f"adamanip {name}" in capsys.readouterr().out
