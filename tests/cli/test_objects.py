"""`adamanip objects`: the list, the sheet's layout, and portraits that show something."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from asset_folders import adamanip_bottle, adamanip_safe, partnet_safe
from PIL import Image

from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.cli import main as cli
from lerobot_adamanip.cli.objects import Thumbnail, compose_sheet
from lerobot_env_adamanip.sim import render_device


def test_the_list_needs_no_simulator(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["objects", "--objects", "34:38", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [row["object_id"] for row in listed["objects"]] == ["safe_034", "safe_035", "safe_036", "safe_037"]
    assert [row["split"] for row in listed["objects"]] == ["seen", "seen", "unseen", "unseen"]
    assert all({"door", "knob"} == set(row["joints"]) and row["description"] for row in listed["objects"])
    assert listed["out"] is None


def test_a_folder_of_external_assets_is_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    adamanip_safe(tmp_path / "safe" / "sa1")
    adamanip_safe(tmp_path / "safe" / "sa2", limits=(0, 0.17))
    partnet_safe(tmp_path / "safe" / "101564")
    adamanip_bottle(tmp_path / "bottle" / "b1")
    assert cli.main(["objects", "--assets", str(tmp_path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [(row["object_id"], row["split"]) for row in told["objects"]] == [("safe:sa1", None)]
    reasons = {row["object_id"]: row["reason"] for row in told["unusable"]}
    assert "does not say where its handle is held" in reasons["safe:101564"]
    assert "joint door goes 0.17 rad" in reasons["safe:sa2"]
    assert cli.main(["objects", "--assets", str(tmp_path), "--category", "all"]) == 0
    text = capsys.readouterr().out
    assert "bottle:b1" in text
    assert "safe:sa2  cannot be used" in text
    assert "2 usable, 2 not" in text


@pytest.mark.parametrize(("count", "columns"), [(1, 9), (5, 2), (6, 3)])
def test_every_portrait_is_on_the_sheet_once(count: int, columns: int, tmp_path: Path) -> None:
    shades = [30 + 25 * number for number in range(count)]
    portraits = [
        Thumbnail(np.full((80, 80, 3), (shade, 0, 255 - shade), np.uint8), f"safe_{n:03d}", "arch, pointer, hinge left")
        for n, shade in enumerate(shades)
    ]
    compose_sheet(portraits, columns=columns, path=tmp_path / "deep" / "sheet.png")
    sheet = np.asarray(Image.open(tmp_path / "deep" / "sheet.png").convert("RGB"))
    for shade in shades:
        assert (sheet == (shade, 0, 255 - shade)).all(-1).sum() == 80 * 80


@pytest.mark.sim
def test_a_portrait_shows_the_object_and_its_door() -> None:
    from lerobot_env_adamanip.sim.thumbnails import render_thumbnail

    safe = make_object("safe_014")
    shut, ajar = (render_thumbnail(safe, size=96, open_fraction=fraction).astype(int) for fraction in (0.0, 0.4))
    assert shut.shape == (96, 96, 3)
    middle, corner = shut[36:60, 36:60], shut[:10, :10]
    assert np.abs(middle.mean((0, 1)) - corner.mean((0, 1))).max() > 25
    assert (np.abs(shut - ajar).max(-1) > 20).mean() > 0.05
    assert np.array_equal(shut, render_thumbnail(safe, size=96).astype(int))


def test_a_sheet_is_refused_at_once_where_nothing_renders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(render_device, "can_render", lambda: False)
    assert cli.main(["objects", "--category", "safe", "--out", str(tmp_path / "sheet.png")]) == 2
    assert "SAPIEN found no Vulkan device" in capsys.readouterr().err
