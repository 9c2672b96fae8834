"""Fixtures of all tests: no network, no user cache, one thread, fixed seeds; and progress in logs."""

from __future__ import annotations

import functools
import logging
import os
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from filelock import FileLock

from lerobot_adamanip.util.errors import AdaManipError

# Before anything imports huggingface_hub or torch: both read these once. Subprocesses inherit them.
os.environ.update(
    HF_HUB_OFFLINE="1",
    HF_HUB_DISABLE_TELEMETRY="1",
    WANDB_MODE="disabled",
    TOKENIZERS_PARALLELISM="false",
    MPLBACKEND="Agg",
    OMP_NUM_THREADS="1",
    MKL_NUM_THREADS="1",
)

ROOT = Path(__file__).resolve().parents[1]
SEED = 0
SHORT = {"assets", "evaluation", "experts", "mechanisms", "objects"}
"""Folders of tests that take milliseconds each."""
Once = Callable[[str, Callable[[Path], Any]], Path]


@pytest.fixture(scope="session")
def project_root() -> Path:
    """The checkout."""
    return ROOT


@pytest.fixture(autouse=True)
def _seed_everything() -> None:
    """A test that draws without a generator of its own draws the same every time, alone or among others."""
    random.seed(SEED)
    if "numpy" in sys.modules:
        sys.modules["numpy"].random.seed(SEED)
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(SEED)


@pytest.fixture(autouse=True)
def _keep_log_level() -> Iterator[None]:
    """A command sets the root logger's level for its process; the tests after it see warnings again."""
    root = logging.getLogger()
    level = root.level
    yield
    if root.level != level:
        root.setLevel(level)


# Machines are shared: how long an example takes says nothing about the code.
hypothesis.settings.register_profile("shared", deadline=None)
hypothesis.settings.load_profile("shared")


@pytest.fixture(scope="session")
def refuses() -> Callable[[type[AdaManipError], Callable[[], Any]], str]:
    """Calls something that must raise; returns the message, which has to say all four things."""

    def check(kind: type[AdaManipError], call: Callable[[], Any]) -> str:
        with pytest.raises(kind) as caught:
            call()
        message = str(caught.value)
        assert all(word in message for word in ("got:", "allowed:", "try:"))
        return message

    return check


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Returns a folder that is filled once a run, by the first of xdist's workers that asks. Not to be written to."""
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "once"
    shared.mkdir(exist_ok=True)

    def folder(name: str, fill: Callable[[Path], Any]) -> Path:
        done = shared / f"{name}.done"
        with FileLock(shared / f"{name}.lock"):
            if not done.exists():
                shutil.rmtree(shared / name, ignore_errors=True)  # of a worker that failed
                fill(shared / name)
                done.touch()
        return shared / name

    return folder


@pytest.fixture(scope="session")
def finished(once: Once) -> Path:
    """A complete dataset of the fake environment, recorded by one worker without interruption."""
    return once("finished", _collected) / "dataset"


@pytest.fixture(scope="session")
def unpictured(once: Once) -> Path:
    """As `finished`, without pictures."""
    return once("unpictured", functools.partial(_collected, observe_images=False)) / "dataset"


def _collected(root: Path, **options: Any) -> None:
    from demos_helpers import fakes, make_spec, patiently

    from lerobot_adamanip.collection.collect import collect

    collect(root / "dataset", make_spec(**options), fakes(), patiently())


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Collections are recorded in this process: without seconds of start, and with a test's crash points."""
    from demos_helpers import InThisProcess

    from lerobot_adamanip.util import jobs

    monkeypatch.setattr(jobs, "WorkerPool", InThisProcess)


@pytest.fixture(scope="session")
def published(once: Once) -> Path:
    """A complete dataset with late starts and attempts that failed."""
    from sound_demos import collect_sound

    return once("published", lambda root: collect_sound(root / "dataset")) / "dataset"


@pytest.fixture
def no_vulkan(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine without any Vulkan device: for this process and those that it starts."""
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(name, "/nonexistent.json")


class _Progress:
    """Counts tests as they end and writes a line now and then: a log shows no row of dots before it is full."""

    EVERY_SECONDS = 30.0

    def __init__(self, reporter: pytest.TerminalReporter) -> None:
        self._reporter = reporter
        self._began = self._said = time.monotonic()
        self._done = self._failed = 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._failed += report.failed
        self._done += report.when == "teardown"
        now = time.monotonic()
        if now - self._said >= self.EVERY_SECONDS:
            self._said = now
            self._reporter.write_line(f"== {now - self._began:.0f} s: {self._done} tests, {self._failed} failed")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Puts files with the simulator first, those with many short tests last: no worker ends long after the others."""
    slow = {item.path for item in items if item.get_closest_marker("sim")}
    items.sort(key=lambda item: (item.path not in slow, item.path.parent.name in SHORT))  # else as they were


@pytest.hookimpl(trylast=True)  # the terminal's plugin is there by then
def pytest_configure(config: pytest.Config) -> None:
    caches = Path(tempfile.mkdtemp(prefix="adamanip-tests-"))
    config.add_cleanup(functools.partial(shutil.rmtree, caches, ignore_errors=True))
    os.environ.update(
        HF_HOME=str(caches), HF_LEROBOT_HOME=str(caches / "lerobot"), HF_DATASETS_CACHE=str(caches / "datasets")
    )
    if not sys.stdout.isatty() and not hasattr(config, "workerinput"):
        reporter = config.pluginmanager.get_plugin("terminalreporter")
        if reporter is not None:
            config.pluginmanager.register(_Progress(reporter), "progress-in-logs")
