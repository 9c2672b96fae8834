"""A process without a home folder or a user name is told so before it records anything."""

from __future__ import annotations

import pwd
from pathlib import Path

import pytest

from lerobot_adamanip.cli import doctor
from lerobot_adamanip.cli.main import COMMANDS, load, main
from lerobot_adamanip.util.account import require_account
from lerobot_adamanip.util.errors import ConfigurationError

NAMES = ("LOGNAME", "USER", "LNAME", "USERNAME", "TORCHINDUCTOR_CACHE_DIR")


@pytest.fixture
def foreign(monkeypatch: pytest.MonkeyPatch) -> None:
    """A user id without an account, as `docker run -u 12345` has."""

    def unknown(uid: int) -> None:
        raise KeyError(f"getpwuid(): uid not found: {uid}")

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)


@pytest.mark.usefixtures("foreign")
@pytest.mark.parametrize(
    ("variables", "missing"),
    [
        ({}, "HOME"),
        ({"USER": "me"}, "HOME"),
        ({"HOME": "/somewhere"}, "USER"),
        ({"HOME": "/somewhere", "USER": "me"}, None),
        ({"HOME": "/somewhere", "TORCHINDUCTOR_CACHE_DIR": "/cache"}, None),
    ],
)
def test_what_is_missing_is_named(
    variables: dict[str, str], missing: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HOME", raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    check = doctor.check_account()
    assert check.ok == (missing is None)
    if missing is None:
        require_account()
        return
    assert f"{missing} is not set" in check.found
    assert f"{missing}=" in check.advice
    with pytest.raises(ConfigurationError, match=f"{missing} is not set"):
        require_account()
    assert [each.name for each in doctor.run_checks()] == ["Python", "Account"], "the others would mislead"


@pytest.mark.usefixtures("foreign")
@pytest.mark.parametrize("name", sorted(set(COMMANDS) - {"doctor"}))
def test_no_command_begins_without_it(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = {
        "push": "environment --repo-id me/x",
        "annotate": "new",
        "view": "dataset --out new",
        **dict.fromkeys(("merge", "filter", "split", "keyframes", "memory"), "dataset --out new"),
        **dict.fromkeys(("collect", "replay", "render", "check", "stats", "calibrate"), "dataset"),
    }
    monkeypatch.setattr(load(name), "run", lambda _: pytest.fail("it began"))
    assert main([name, *lines.get(name, "").split()]) == 2
    assert "export USER=me" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
