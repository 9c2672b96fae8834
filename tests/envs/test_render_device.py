"""Which device renders is found out once, by a process that may crash or hang."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

from lerobot_adamanip.errors import ConfigurationError
from lerobot_env_adamanip.sim import render_device
from lerobot_env_adamanip.sim.render_device import cache_file, gpu_renders, resolve_render_backend


@pytest.fixture(autouse=True)
def _a_gpu_and_a_cache_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(render_device, "_has_gpu", lambda: True)


class Probe:
    def __init__(self, answer: bool) -> None:
        self.answer, self.calls = answer, 0

    def __call__(self) -> bool:
        self.calls += 1
        return self.answer


@pytest.mark.parametrize(("renders", "backend"), [(True, "cuda"), (False, "cpu")])
def test_auto_is_what_the_probe_says(renders: bool, backend: str) -> None:
    assert resolve_render_backend("auto", Probe(renders)) == backend


@pytest.mark.parametrize("wanted", ["cuda", "cpu"])
def test_what_is_asked_for_is_not_probed(wanted: str) -> None:
    probe = Probe(False)
    assert resolve_render_backend(wanted, probe) == wanted
    assert probe.calls == 0


def test_another_name_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*auto"):
        resolve_render_backend("vulkan")


@pytest.mark.parametrize("renders", [True, False])
def test_a_machine_is_probed_once(renders: bool) -> None:
    probe = Probe(renders)
    assert [gpu_renders(probe) for _ in range(3)] == [renders] * 3
    assert probe.calls == 1


def test_another_driver_is_probed_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    probe, driver = Probe(True), tmp_path / "version"
    monkeypatch.setattr(render_device, "_DRIVER", driver)
    for version in ("570", "580"):
        driver.write_text(version)
        gpu_renders(probe)
    assert probe.calls == 2


@pytest.mark.parametrize("content", ["", "[1]", '{"x": 3}', "\x00"])
def test_a_broken_cache_is_no_answer(content: str) -> None:
    cache_file().parent.mkdir(parents=True)
    cache_file().write_text(content)
    probe = Probe(True)
    assert gpu_renders(probe)
    assert probe.calls == 1


def test_a_cache_that_cannot_be_written_does_no_harm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert gpu_renders(Probe(True))


@pytest.mark.parametrize(
    "code",
    ["import os; os.abort()", "import time; time.sleep(60)", "raise RuntimeError"],
    ids=["crash", "hang", "error"],
)
def test_a_probe_that_crashes_or_hangs_is_a_no(code: str) -> None:
    began = time.monotonic()
    assert not render_device._takes_a_picture((sys.executable, "-c", code), seconds=5.0)
    assert time.monotonic() - began < 30.0


def test_a_probe_that_ends_well_is_a_yes() -> None:
    assert render_device._takes_a_picture((sys.executable, "-c", ""), seconds=60.0)


def test_without_a_gpu_nothing_is_probed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(render_device, "_has_gpu", lambda: False)
    probe = Probe(True)
    assert not gpu_renders(probe)
    assert probe.calls == 0
    assert not cache_file().exists()
