"""Closing: everything is closed, and the error that came first is the one that is raised."""

from __future__ import annotations

import logging
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lerobot_adamanip.hardware.adamanip_franka.adamanip_franka import AdamanipFranka
from lerobot_adamanip.hardware.adamanip_franka.config_adamanip_franka import AdamanipFrankaConfig
from lerobot_adamanip.hardware.arm import Served
from lerobot_adamanip.hardware.arm_process import server as program
from lerobot_adamanip.hardware.closing import close_all, closing_on_error
from lerobot_adamanip.hardware.robot_registry import ROBOTS
from lerobot_adamanip.hardware.teleoperators.config_devices import AdamanipKeyboardConfig
from lerobot_adamanip.hardware.teleoperators.devices import AdamanipKeyboard
from lerobot_adamanip.util.errors import RobotError
from lerobot_env_adamanip.twin.config_devices import AdamanipFrankaSimConfig
from lerobot_env_adamanip.twin.franka_sim import AdamanipFrankaSim

closed: list[str] = []


@pytest.fixture(autouse=True)
def _nothing_closed() -> None:
    closed.clear()


class Resource:
    """A camera or client that fails where its name says so: ``fails`` on closing, ``missing`` on connecting."""

    width, height, use_rgb, is_connected = 8, 8, True, True
    server = SimpleNamespace(lockstep_fps=None)

    def __init__(self, name: str) -> None:
        self.name = name

    def connect(self) -> dict[str, Any]:
        if "missing" in self.name:
            raise RobotError(f"{self.name} is not there")
        return {}

    def disconnect(self) -> None:
        closed.append(self.name)
        if "fails" in self.name:
            raise OSError(f"{self.name} at closing")

    def request(self, *_: Any, **__: Any) -> dict[str, Any]:
        raise RobotError("the process does not answer")

    close = disconnect


def robot(folder: Path, *cameras: str) -> AdamanipFranka:
    config = AdamanipFrankaConfig(id="closing", calibration_dir=folder, box_lower=(0, 0, 0), box_upper=(1, 1, 1))
    made = AdamanipFranka(config)
    made.cameras = {name: Resource(name) for name in cameras}  # type: ignore[misc]
    made._make_client = lambda: Resource("arm")  # type: ignore[assignment,method-assign,return-value]
    made._open_session = lambda *_: ROBOTS.open("closing")  # type: ignore[assignment,method-assign]
    return made


def test_a_camera_that_fails_at_closing_leaves_no_other_open(tmp_path: Path) -> None:
    made = robot(tmp_path, "first fails", "second", "third fails")
    made.connect()
    with pytest.raises(OSError, match="first fails at closing"):
        made.disconnect()
    assert closed == ["arm", "first fails", "second", "third fails"]
    assert ROBOTS.find("closing") is None
    made.disconnect()
    assert len(closed) == 4


def test_an_error_of_closing_does_not_hide_the_one_of_connecting(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(RobotError, match="second missing is not there"):
        robot(tmp_path, "first fails", "second missing").connect()
    assert closed == ["arm", "first fails", "second missing"]
    assert "first fails at closing" in caplog.text


def test_a_log_that_cannot_be_written_does_not_leave_the_twin_running(tmp_path: Path) -> None:
    twin = AdamanipFrankaSim(AdamanipFrankaSimConfig(camera=False, episode_log=str(tmp_path / "log.jsonl")))
    twin._client, twin._moved = Resource("simulator"), True  # type: ignore[assignment]
    with pytest.raises(RobotError, match="does not answer"):
        twin.disconnect()
    assert closed == ["simulator"]
    assert not twin.is_connected


def test_a_device_that_fails_while_it_opens_is_closed() -> None:
    class Broken(AdamanipKeyboard):
        def _listen(self) -> Any:
            self._listener = Resource("keys")
            raise RobotError("no display")

        def _close(self) -> None:
            self._listener.disconnect()

    device = Broken(AdamanipKeyboardConfig())
    with pytest.raises(RobotError, match="no display"):
        device.connect()
    assert closed == ["keys"]
    assert not device.is_connected


def test_an_arm_that_fails_while_it_connects_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    backend: Any = Resource("arm missing")
    monkeypatch.setattr(program, "Connection", lambda _: SimpleNamespace(recv_bytes=bytes, send_bytes=len))
    monkeypatch.setattr(program, "decode", lambda *_: SimpleNamespace(capacities={}, options=None))
    monkeypatch.setattr(program, "map_mailboxes", lambda *_: {})
    monkeypatch.setattr(program.pkgutil, "resolve_name", lambda _: lambda *_: Served(backend))
    assert program.main(0, 0, "module:factory") == 1
    assert closed == ["arm missing"]


def test_all_are_called_and_the_first_error_is_raised(caplog: pytest.LogCaptureFixture) -> None:
    resources = [Resource(name) for name in ("a", "b fails", "c fails", "d")]
    with caplog.at_level(logging.WARNING), pytest.raises(OSError, match="b fails"):
        close_all([each.disconnect for each in resources])
    assert closed == ["a", "b fails", "c fails", "d"]
    assert "c fails" in caplog.text
    with pytest.raises(KeyboardInterrupt), closing_on_error(resources[1].disconnect):
        raise KeyboardInterrupt
    close_all([])
