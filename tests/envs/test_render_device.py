"""Which device renders is found out once, by a process that may crash or hang."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.sim import render_device
from lerobot_env_adamanip.sim.render_device import (
    cache_file,
    can_render,
    gpu_renders,
    resolve_render_backend,
    vulkan_drivers,
)


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


def manifests(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True)
    for name in names:
        (folder / name).write_text("{}")
    return folder


def only_here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Leaves the Vulkan loader one folder to look for drivers in, which is not there yet."""
    monkeypatch.setattr(render_device, "_DRIVER", tmp_path / "no_nvidia")
    monkeypatch.setattr(render_device, "_ETC", tmp_path / "etc")
    for name in ("XDG_CONFIG_DIRS", "XDG_DATA_DIRS", "XDG_DATA_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "share"))
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_ADD_DRIVER_FILES"):
        monkeypatch.delenv(name, raising=False)


def test_without_a_driver_nothing_renders_and_nothing_is_probed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    only_here(monkeypatch, tmp_path)
    probe = Probe(True)
    assert not can_render(probe)
    folder = manifests(tmp_path / "share" / "vulkan" / "icd.d", "lvp.json")
    assert can_render(probe)
    assert can_render(probe)
    assert probe.calls == 1
    (folder / "other.json").write_text("{}")  # another driver is installed: the answer may be another one
    assert can_render(probe)
    assert probe.calls == 2
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(name, "/dev/null")  # overrides what is installed
        assert not can_render(probe)
        monkeypatch.delenv(name)
    assert probe.calls == 2


def test_drivers_are_found_where_the_loader_finds_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    only_here(monkeypatch, tmp_path)
    chosen = manifests(tmp_path / "chosen", "a.json", "b.json", "c.txt")
    monkeypatch.setenv("VK_ADD_DRIVER_FILES", str(chosen))
    manifests(tmp_path / "etc" / "vulkan" / "icd.d", "etc.json")
    assert [Path(each.split()[0]).name for each in vulkan_drivers()] == ["etc.json", "a.json", "b.json"]
    monkeypatch.setenv("VK_DRIVER_FILES", str(chosen / "a.json"))
    assert [Path(each.split()[0]).name for each in vulkan_drivers()] == ["a.json"]
