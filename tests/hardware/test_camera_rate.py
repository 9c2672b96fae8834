"""Two cameras through LeRobot's recording loop. The measurement itself: ``scripts/check_cameras.py``."""

from __future__ import annotations

from pathlib import Path

import check_cameras
import pytest


def test_a_frozen_camera_ends_the_recording_with_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_cameras, "FRAMES", 20)
    found = check_cameras.freezing(tmp_path, seconds=60, max_age=0.5)
    assert found["named"], found
    assert found["oldest_s"] <= 0.51  # no stale picture is taken


@pytest.mark.nightly
@pytest.mark.timeout(400)
def test_two_cameras_keep_thirty_hertz_for_a_minute(tmp_path: Path) -> None:
    found = check_cameras.timing(tmp_path, seconds=60, max_age=0.5)
    assert found["frames"] >= 0.97 * 60 * check_cameras.FPS
    assert found["late_share"] < check_cameras.LATE_SHARE
    assert found["p99_ms"] <= check_cameras.P99_MS
