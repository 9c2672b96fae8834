"""An episode to look at: what is drawn is what was recorded, and the picture in the documents is up to date."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import urllib.request
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Outcome, Phase
from lerobot_adamanip.datasets.episode_facts import recoveries
from lerobot_adamanip.datasets.view import viewer
from lerobot_adamanip.datasets.view.episode import ViewedEpisode, read_episode
from lerobot_adamanip.datasets.view.still import draw, drawn, write_still
from lerobot_adamanip.util.errors import ConfigurationError

ROOT = Path(__file__).resolve().parents[2]
SAFE = Path(__file__).with_name("safe_episode")
"""A dataset of one episode, of `adamanip collect`: a locked safe, a pull that fails, the knob turned the wrong way, the
other way, and a pull that opens. Its statistics per episode are left out."""
PICTURE = ROOT / "docs" / "images" / "view.png"
"""Made by ``adamanip view tests/datasets/safe_episode --out docs/images/view.png``."""
MOST_BYTES = 300_000
SIMILAR = 4.0
"""Mean difference of a pixel, of 255, that other versions of fonts make."""


@pytest.fixture(scope="module")
def safe() -> ViewedEpisode:
    return read_episode(SAFE, 0)


def rows() -> dict[str, np.ndarray]:
    table = pq.read_table(sorted((SAFE / "data").glob("*/*.parquet")))
    return {name: np.asarray(table[name].to_pylist()) for name in table.column_names}


def test_an_episode_is_read_as_it_was_recorded(safe: ViewedEpisode) -> None:
    columns = rows()
    np.testing.assert_array_equal(
        safe.clouds, columns[schema.POINT_CLOUD].astype(np.float32).reshape(safe.clouds.shape)
    )
    assert safe.clouds.shape[1:] == (1024, 3)
    np.testing.assert_array_equal(safe.tools, columns[schema.STATE][:, :10].astype(np.float32))
    np.testing.assert_array_equal(safe.goals, columns[schema.EXECUTED][:-1].astype(np.float32))
    np.testing.assert_array_equal(safe.effort, columns[schema.EFFORT].astype(np.float32))
    assert safe.key_frames == len(columns["index"]) - 1 == 21
    tried = np.flatnonzero(columns[schema.TRIED][:-1] >= 0).tolist()
    assert [each.key_frame for each in safe.tries] == tried
    failed = columns[schema.FAILED][tried].tolist()
    assert [each.failed for each in safe.tries] == failed
    assert sum(each.recovers for each in safe.tries) == recoveries(failed) == 1
    assert [each.joint for each in safe.tries] == ["door", *["knob"] * 3, *["door"] * 4]
    assert safe.title.startswith("episode 0 · safe_004 · hidden: direction 1, knob_range 1.26, locked true")
    assert safe.title.endswith("success after 2 failed tries")


def test_phases_are_runs_of_key_frames(safe: ViewedEpisode) -> None:
    runs = list(safe.phase_runs())
    assert runs[0] == (Phase.APPROACH, 0, 2)
    assert runs[-1] == (Phase.OPEN, 18, 21)
    assert [first for _, first, _ in runs[1:]] == [end for *_, end in runs[:-1]]
    assert [phase for phase, first, end in runs for _ in range(first, end)] == list(safe.phases)


def test_a_picture_shows_cloud_path_goals_tries_phases_and_effort(safe: ViewedEpisode) -> None:
    found = drawn(draw(safe))
    views = 2
    assert found["title"] == safe.title
    assert found["cloud"] == views * 1024
    assert (found["path"], found["goals"], found["hands"]) == (views * 22, views * 21, views * 21 * 2)
    assert (found["failed try"], found["try that worked"]) == (views * 2, views * 6)
    assert (found["tries"], len(found["try"]) + len(found["recoveries"])) == (8, 8)
    assert found["recoveries"] == ["+0.69\nrecovers"]
    assert found["try"].count("+0.00\nfailed") == 2
    assert found["phases"] == len(list(safe.phase_runs()))
    assert found["phase"][:4] == ["approach", "grasp", "try", "release"]
    assert found["stalled"] == sum(outcome is Outcome.STALLED for outcome in safe.outcomes) == 3
    assert found["effort"] == 7 * 22
    assert found["felt"] == 2


def test_marks_stand_where_the_tool_was(safe: ViewedEpisode) -> None:
    _, above = draw(safe).axes[:2]
    (marks,) = [each for each in above.collections if each.get_gid() == "failed try"]
    ended = [each.key_frame + 1 for each in safe.tries if each.failed]
    np.testing.assert_allclose(marks.get_offsets(), safe.tools[ended, 1::-1], atol=1e-6)
    (line,) = [each for each in above.lines if each.get_gid() == "path"]
    np.testing.assert_allclose(line.get_xydata(), safe.tools[:, 1::-1], atol=1e-6)


def test_the_picture_in_the_documents_is_up_to_date(safe: ViewedEpisode, tmp_path: Path) -> None:
    """If not: `adamanip view tests/datasets/safe_episode --out docs/images/view.png`."""
    write_still(safe, tmp_path / "view.png")
    with Image.open(tmp_path / "view.png") as made, Image.open(PICTURE) as stored:
        assert made.size == stored.size == (1100, 780)
        assert json.loads(made.info["Description"]) == json.loads(stored.info["Description"])
        pixels = [np.asarray(each.convert("RGB"), dtype=float) for each in (made, stored)]
    assert np.abs(pixels[0] - pixels[1]).mean() < SIMILAR
    assert PICTURE.stat().st_size < MOST_BYTES


def test_pictures_and_what_is_not_known_are_no_hindrance(finished: Path, unpictured: Path, tmp_path: Path) -> None:
    seen = read_episode(finished, 2, images=True)
    assert seen.images is not None
    assert seen.images.shape == (len(seen.tools), 64, 64, 3)
    assert seen.camera is None, "the fake environment tells of cameras otherwise"
    assert read_episode(unpictured, 2, images=True).images is None
    assert drawn(draw(seen))["goals"] == 2 * seen.key_frames
    copy = tmp_path / "copy"
    shutil.copytree(SAFE, copy)
    info = json.loads((copy / "meta" / "info.json").read_text())
    (path,) = (copy / "data").rglob("*.parquet")
    labels = [name for name in info["features"] if name.startswith("complementary_info.") or name == schema.EFFORT]
    pq.write_table(pq.read_table(path).drop_columns(labels), path)
    for name in labels:
        del info["features"][name]
    (copy / "meta" / "info.json").write_text(json.dumps(info))
    bare = read_episode(copy, 0)
    assert (bare.tries, bare.effort.shape) == ((), (22, 0))
    assert drawn(draw(bare))["path"] == 2 * 22


def test_what_cannot_be_shown_is_one_clear_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")  # or that it lacks is what is said first
    monkeypatch.setitem(sys.modules, "rerun", None)
    for options, said in (
        ([str(SAFE), "--episode", "1"], "No such episode"),
        ([str(tmp_path / "none")], "There is no dataset"),
        ([str(SAFE), "--out", str(tmp_path / "x.gif")], "Unknown kind of file"),
        ([str(SAFE), "--out", str(tmp_path / "x.rrd")], r"lerobot[viz]"),
    ):
        assert main(["view", *options]) == 2
        assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_picture_needs_no_viewer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["view", str(SAFE), "--out", str(tmp_path / "new" / "x.png")]) == 0
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["x.png"]
    assert "safe_004" in capsys.readouterr().out


# rerun ------------------------------------------------------------------------------------------------------------


def test_a_recording_holds_every_row(safe: ViewedEpisode, tmp_path: Path) -> None:
    from rerun.experimental import RrdReader

    assert main(["view", str(SAFE), "--out", str(tmp_path / "safe.rrd")]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["safe.rrd"]
    reader = RrdReader(tmp_path / "safe.rrd")
    assert (len(reader.recordings()), len(reader.blueprints())) == (1, 1)
    chunks = list(reader.stream())
    count: Counter[str] = Counter()
    for chunk in chunks:
        count[chunk.entity_path] += 0 if chunk.is_static else chunk.num_rows
    assert {count[name] for name in ("/world/cloud", "/world/tool/path", "/world/tool/pose", "/effort")} == {22}
    assert {count[name] for name in ("/world/goal/pose", "/world/goal/point")} == {21}
    assert [count[f"/world/tries/{each.key_frame}"] for each in safe.tries] == [1] * 8
    assert count["/log"] == 21 + len(safe.tries)
    clouds = [chunk.to_record_batch() for chunk in chunks if chunk.entity_path == "/world/cloud"]
    points = [cloud for batch in clouds for cloud in batch["Points3D:positions"].to_pylist()]
    np.testing.assert_allclose(sorted(np.sum(points, axis=(1, 2))), sorted(safe.clouds.sum(axis=(1, 2))), rtol=1e-4)


def test_pictures_are_in_the_recording(finished: Path, tmp_path: Path) -> None:
    from rerun.experimental import RrdReader

    viewer.save(read_episode(finished, 0, images=True), tmp_path / "x.rrd")
    assert "/camera" in {chunk.entity_path for chunk in RrdReader(tmp_path / "x.rrd").stream()}


def test_half_a_recording_is_not_left(safe: ViewedEpisode, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(viewer, "_log_key_frame", fail)
    with pytest.raises(KeyboardInterrupt):
        viewer.save(safe, tmp_path / "x.rrd")
    assert list(tmp_path.iterdir()) == []


def test_a_browser_is_served(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    words = [sys.executable, "-m", "lerobot_adamanip.cli.main", "view", str(SAFE), "--web", "--port", str(port)]
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": path}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment, cwd=tmp_path) as process:
        try:
            assert process.stdout is not None
            address = next(line for line in process.stdout if line.startswith("http")).split()[0]
            with urllib.request.urlopen(address, timeout=30) as page:
                assert b"rerun" in page.read().lower()
        finally:
            process.kill()


def test_a_missing_viewer_says_what_to_install(monkeypatch: pytest.MonkeyPatch, safe: ViewedEpisode) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ConfigurationError, match="--out"):
        viewer.spawn(safe)


def test_without_a_display_the_ways_to_look_are_named_before_anything_is_loaded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert main(["view", str(tmp_path / "none")]) == 2
    told = capsys.readouterr().err
    assert told.count("error: ") == 1
    assert "no dataset" not in told
    assert all(option in told for option in ("--out", "--web"))


def test_what_nobody_has_labelled_is_not_shown_as_a_label(safe: ViewedEpisode, tmp_path: Path) -> None:
    root = Path(shutil.copytree(SAFE, tmp_path / "unlabelled"))
    (path,) = (root / "data").rglob("*.parquet")
    table = pq.read_table(path)
    for name in (schema.PHASE, schema.OUTCOME, schema.TRIED):
        at = table.schema.get_field_index(name)
        table = table.set_column(at, table.schema.field(at), pa.array([-1] * len(table), table.schema.field(at).type))
    pq.write_table(table, path)
    found = read_episode(root, 0)
    assert set(found.phases) == set(found.outcomes) == {None}
    assert found.title.endswith("success")
    shown = drawn(draw(found))
    assert "phases" not in shown
    assert "not labelled" in str(shown["phase"])
    assert "phases" in drawn(draw(safe))
