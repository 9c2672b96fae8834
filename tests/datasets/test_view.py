"""An episode to look at: what is drawn is what was recorded, and the picture in the documents is up to date."""

from __future__ import annotations

import itertools
import json
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure
from PIL import Image

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.keyframes import Outcome, Phase
from lerobot_adamanip.datasets.view import ShownEpisode, draw, read_episode

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
def safe() -> ShownEpisode:
    return read_episode(SAFE, 0)


def rows() -> dict[str, np.ndarray]:
    table = pq.read_table(sorted((SAFE / "data").glob("*/*.parquet")))
    return {name: np.asarray(table[name].to_pylist()) for name in table.column_names}


def test_an_episode_is_read_as_it_was_recorded(safe: ShownEpisode) -> None:
    columns = rows()
    np.testing.assert_array_equal(
        safe.clouds, columns[schema.POINT_CLOUD].astype(np.float32).reshape(safe.clouds.shape)
    )
    assert safe.clouds.shape[1:] == (1024, 3)
    np.testing.assert_array_equal(safe.tools, columns[schema.STATE][:, :3].astype(np.float32))
    np.testing.assert_array_equal(safe.goals, columns[schema.EXECUTED][:-1, :3].astype(np.float32))
    np.testing.assert_array_equal(safe.effort, columns[schema.EFFORT].astype(np.float32))
    assert len(safe.goals) == len(columns["index"]) - 1 == 21
    tried = np.flatnonzero(columns[schema.TRIED][:-1] >= 0).tolist()
    assert [each.row for each in safe.tries] == tried
    failed = columns[schema.FAILED][tried].tolist()
    assert [each.failed for each in safe.tries] == failed
    assert sum(each.recovers for each in safe.tries) == 1
    assert [each.joint for each in safe.tries] == ["door", *["knob"] * 3, *["door"] * 4]
    assert safe.title.startswith("episode 0 · safe_004 · hidden: direction 1, knob_range 1.26, locked true")
    assert safe.title.endswith("success after 2 failed tries")


def drawn(figure: Figure) -> Counter[str]:
    """Returns how many points, or texts, a picture shows of each part."""
    found: Counter[str] = Counter()
    for axes in figure.axes:
        for artist in (*axes.collections, *axes.lines, *axes.patches, *axes.texts):
            offsets = artist.get_offsets() if hasattr(artist, "get_offsets") else [0]
            found[artist.get_gid() or ""] += len(artist.get_xdata() if hasattr(artist, "get_xdata") else offsets)
    return found


def test_a_picture_shows_path_goals_tries_phases_and_effort_where_they_were(safe: ShownEpisode) -> None:
    assert safe.phases[:3] == (Phase.APPROACH, Phase.APPROACH, Phase.GRASP)
    runs = len(list(itertools.groupby(safe.phases)))
    figure = draw(safe)
    found = drawn(figure)
    assert figure.get_suptitle() == safe.title
    assert 100 < found["cloud"] <= 1024
    assert (found["goals"], found["failed try"], found["try that worked"]) == (21, 2, 6)
    assert (found["tries"], found["numbers"], found["phases"], found["effort"]) == (8, 3, runs, 7 * 22)
    assert found["stalled"] == sum(outcome is Outcome.STALLED for outcome in safe.outcomes) == 3
    (marks,) = [each for each in figure.axes[0].collections if each.get_gid() == "failed try"]
    ended = [each.row + 1 for each in safe.tries if each.failed]
    np.testing.assert_allclose(np.stack(marks._offsets3d).T, safe.tools[ended, :3], atol=1e-6)


def test_the_picture_in_the_documents_is_up_to_date(tmp_path: Path) -> None:
    """If not: `adamanip view tests/datasets/safe_episode --out docs/images/view.png`."""
    assert main(["view", str(SAFE), "--out", str(tmp_path / "view.png")]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["view.png"]
    with Image.open(tmp_path / "view.png") as made, Image.open(PICTURE) as stored:
        pixels = [np.asarray(each.convert("RGB"), dtype=float) for each in (made, stored)]
    assert np.abs(pixels[0] - pixels[1]).mean() < SIMILAR
    assert PICTURE.stat().st_size < MOST_BYTES


def test_what_is_not_known_is_left_out(tmp_path: Path) -> None:
    copy = Path(shutil.copytree(SAFE, tmp_path / "copy"))
    (path,) = (copy / "data").rglob("*.parquet")
    table = pq.read_table(path)
    for name in (schema.PHASE, schema.OUTCOME, schema.TRIED):
        at = table.schema.get_field_index(name)
        table = table.set_column(at, table.schema.field(at), pa.array([-1] * len(table), table.schema.field(at).type))
    pq.write_table(table, path)
    unlabelled = read_episode(copy, 0)
    assert set(unlabelled.phases) == set(unlabelled.outcomes) == {None}
    assert unlabelled.title.endswith("success")
    assert "not labelled" in {text.get_text() for text in draw(unlabelled).axes[1].texts}
    info = json.loads((copy / "meta" / "info.json").read_text())
    labels = [name for name in info["features"] if name.startswith("complementary_info.") or name == schema.EFFORT]
    pq.write_table(pq.read_table(path).drop_columns(labels), path)
    info["features"] = {name: feature for name, feature in info["features"].items() if name not in labels}
    (copy / "meta" / "info.json").write_text(json.dumps(info))
    bare = read_episode(copy, 0)
    assert (bare.tries, bare.effort.shape) == ((), (22, 0))
    assert drawn(draw(bare))["path"] == 22


def test_what_cannot_be_shown_is_one_clear_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for options, said in (
        ([str(SAFE), "--episode", "1", "--out", str(tmp_path / "x.png")], "No such episode"),
        ([str(tmp_path / "none"), "--out", str(tmp_path / "x.png")], "There is no dataset"),
        ([str(SAFE), "--out", str(tmp_path / "x.gif")], "Unknown kind of file"),
    ):
        assert main(["view", *options]) == 2
        assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
