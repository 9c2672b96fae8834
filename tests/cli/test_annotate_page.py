"""The annotation page as a person has it: the real command, in a real browser, down to the file it saves."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lerobot_adamanip.assets import load_object
from lerobot_adamanip.assets.annotation.session import DRAFT_NAME

sys.path.insert(0, str(Path(__file__).parents[1] / "objects"))
from asset_folders import partnet_safe

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
WITHOUT_A_GPU = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
PATIENCE = 120_000
"""A software renderer on a busy machine is slow [ms]."""
pytestmark = [pytest.mark.timeout(600), pytest.mark.nightly]  # it needs a browser, and a minute and a half of two cores


def works(command: str) -> bool:
    path = shutil.which(command)
    return path is not None and subprocess.run([path, "--version"], capture_output=True, check=False).returncode == 0


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        system = next((shutil.which(command) for command in BROWSERS if works(command)), None)
        try:
            browser = driver.chromium.launch(executable_path=system, args=list(WITHOUT_A_GPU), timeout=PATIENCE)
        except playwright.Error as error:
            if os.environ.get("CI"):
                raise
            pytest.skip(f"no Chromium: scripts/setup_browser.sh installs one ({str(error).splitlines()[0]})")
        tab = browser.new_page(viewport={"width": 900, "height": 560})
        tab.set_default_timeout(PATIENCE)
        yield tab
        browser.close()


# Tests may run in the background of a shell, where processes start with SIGINT ignored; a terminal's do not.
PROGRAM = """
import signal, sys
from lerobot_adamanip.cli.main import main

signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[Path, str, subprocess.Popen[str]]]:
    folder = partnet_safe(tmp_path / "101564")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-c", PROGRAM, "annotate", str(folder), "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    assert process.stdout is not None
    lines = iter(process.stdout.readline, "")
    address = next(line.split("open ")[1].strip() for line in lines if "open http" in line)
    yield folder, address, process
    process.kill()
    process.wait()


def picture(page: Any) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(page.screenshot(timeout=PATIENCE))).convert("RGB")).astype(int)


def drawn(page: Any) -> np.ndarray:
    """The picture once the scene stands still: viser fades it in."""
    before = picture(page)
    for _ in range(60):
        page.wait_for_timeout(500)
        now = picture(page)
        if np.abs(now - before).max() < 12:
            return now
        before = now
    raise AssertionError("the page never comes to rest")


def test_a_person_moves_a_joint_changes_a_limit_and_saves(page: Any, served: Any) -> None:
    folder, address, process = served
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto(address)
    page.get_by_text("101564: proposed from bounding boxes.").wait_for()
    if (hint := page.get_by_role("alert")).count():
        hint.get_by_role("button").first.click()  # viser's warning that there is no GPU
    shut = drawn(page)
    scene = shut[:, :400]
    assert np.ptp(scene, axis=(0, 1)).max() > 80, "something is to be seen"

    door = page.get_by_role("slider").first
    door.focus()
    for _ in range(40):
        door.press("ArrowRight")
    page.wait_for_function("document.querySelector('[role=slider]').getAttribute('aria-valuenow') > 0.3")
    moved = np.abs(drawn(page)[:, :400] - scene).max(axis=-1) > 30
    assert moved.mean() > 0.01, "the door swings"

    opened = page.get_by_label("Open").first
    opened.fill("1.3")
    opened.press("Tab")
    page.get_by_text("Not saved yet (a draft is kept).").wait_for()
    if target := os.environ.get("ADAMANIP_ANNOTATE_PICTURE"):
        page.screenshot(path=target, timeout=PATIENCE)  # how docs/images/annotate.png was made
    page.get_by_role("button", name="Save").click()
    page.get_by_text("101564/adamanip.json").wait_for()

    saved = json.loads((folder / "adamanip.json").read_text())
    assert saved["joints"]["door"] == {"joint": "joint_0", "rest": 0.0, "open": 1.3}
    assert load_object(folder, "safe").joint("door").limits == (0.0, 1.3)
    assert not (folder / DRAFT_NAME).exists()
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 0
    assert problems == []
