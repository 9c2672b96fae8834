"""A dataset is data: what another program would interpret is refused, named by `check`, and written nowhere."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from demos_helpers import another

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets import cutting
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.editing import filter_episodes, merge, split_episodes
from lerobot_adamanip.datasets.encoding import encoder_like
from lerobot_adamanip.hub.staging import stage_dataset
from lerobot_adamanip.util.errors import DatasetError

Change = Callable[[Any], object]
PROOF = "proof.txt"
"""File that a hostile dataset would write, in the folder of the test."""


def in_info(change: Change) -> Callable[[Path], None]:
    def edit(root: Path) -> None:
        path = root / "meta" / "info.json"
        info = json.loads(path.read_text())
        change(info)
        path.write_text(json.dumps(info).replace("PROOF", str(root.parent / PROOF)))

    return edit


def of_front(**values: Any) -> Callable[[Path], None]:
    return in_info(lambda info: info["features"][schema.FRONT_IMAGE]["info"].update(values))


def in_episodes(name: str, value: Any) -> Callable[[Path], None]:
    """Sets a column of every episode."""

    def edit(root: Path) -> None:
        (path,) = (root / "meta" / "episodes").rglob("*.parquet")
        table = pq.read_table(path)
        if name in table.column_names:
            table = table.drop_columns([name])
        pq.write_table(table.append_column(name, pa.array([value] * len(table))), path)

    return edit


def film_is(content: str) -> Callable[[Path], None]:
    """Puts a list of other files in the place of a video; FFmpeg tells formats by content."""

    def edit(root: Path) -> None:
        (film,) = (root / "videos").rglob("*.mp4")
        shutil.copy(film, root.parent / "private.mp4")
        film.write_text(content.format(file=root.parent / "private.mp4"))

    return edit


def task_is(text: str) -> Callable[[Path], None]:
    def edit(root: Path) -> None:
        path = root / "meta" / "tasks.parquet"
        table = pq.read_table(path).to_pandas().rename(index=lambda _: text)
        table.to_parquet(path)
        in_episodes("tasks", [text])(root)

    return edit


def selection_made_with(command: str) -> Callable[[Path], None]:
    def edit(root: Path) -> None:
        content = {"format": 1, "source": "0" * 32, "source_episodes": 9, "episodes": list(range(6))}
        (root / "meta" / "selection.json").write_text(json.dumps({**content, "made_with": [command]}))

    return edit


X264 = {"x264-params": "pass=1:stats=PROOF"}
HOSTILE: dict[str, Callable[[Path], None]] = {
    "options of an encoder": of_front(**{"video.extra_options": X264}),
    "options of an encoder in a known option": of_front(
        **{"video.extra_options": {"x265-params": "lossless=1:csv=PROOF"}}
    ),
    "options of an encoder at another column": in_info(
        lambda info: info["features"]["action"].update(info={"video.extra_options": X264})
    ),
    "nested details": of_front(**{"video.preset": {"x264-params": "stats=PROOF"}}),
    "a template of paths": in_info(lambda info: info.update(video_path="../{video_key}/PROOF")),
    "markup in a robot's name": in_info(lambda info: info.update(robot_type="panda <img src=//evil>")),
    "text for a size of files": in_info(lambda info: info.update(data_files_size_in_mb="1; rm")),
    "chunks of no episode": in_info(lambda info: info.update(chunks_size=0)),
    "no frames in a second": in_info(lambda info: info.update(fps=0)),
    "names that are objects": in_info(lambda info: info["features"]["action"].update(names=[{"a": 1}] * 10)),
    "a column that is a path": in_info(lambda info: info["features"].update({"../x": info["features"]["action"]})),
    "a list of films": film_is("ffconcat version 1.0\nfile private.mp4\n"),
    "a playlist": film_is("#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n{file}\n#EXT-X-ENDLIST\n"),
    "escape sequences in a task": task_is("open \x1b]52;c;ZXZpbA==\x07 it"),
    "escape sequences in a column": in_episodes("note", "\x1b[2J"),
    "markup in a column of a card": in_episodes("expert", "[click](https://evil)"),
    "markup hidden in JSON": in_episodes("versions", '{"lerobot": "\\u003cscript src=x>"}'),
}


def work_on(root: Path, folder: Path, sound: Path) -> list[Callable[[], object]]:
    out = folder / "out"
    (folder / "staged").mkdir(exist_ok=True)
    return [
        lambda: filter_episodes(root, ["episode_index=1"], out),
        lambda: split_episodes(root, out, {"a": 0.5, "b": 0.5}),
        lambda: merge([root, sound], out),
        lambda: stage_dataset(root, "someone/it", folder / "staged"),
    ]


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_dataset_is_refused_named_and_writes_nothing(published: Path, tmp_path: Path, name: str) -> None:
    root = Path(shutil.copytree(published, tmp_path / "evil"))
    sound = another(published, tmp_path / "sound")
    HOSTILE[name](root)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    found = check(root)
    assert "untrusted" in found.counts
    assert not any(character in str(each) for each in found.findings for character in "\x1b\x07")
    for work in work_on(root, tmp_path, sound):
        with pytest.raises(DatasetError) as error:
            work()
        assert "\x1b" not in str(error.value)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert main(["check", str(root)]) == 1


@pytest.mark.parametrize("command", ["rm -rf ~", "adamanip filter DATASET; rm -rf ~", "adamanip collect $(evil)"])
def test_a_card_shows_no_command_that_is_not_ours(published: Path, tmp_path: Path, command: str) -> None:
    root = Path(shutil.copytree(published, tmp_path / "evil"))
    selection_made_with(command)(root)
    for work in (lambda: filter_episodes(root, [], tmp_path / "out"), *work_on(root, tmp_path, root)[3:]):
        with pytest.raises(DatasetError, match="which episodes"):
            work()
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("info", "options"),
    [
        ({"video.codec": "h264", "video.crf": 20, "video.g": 2, "video.preset": "veryfast"}, {"g": 2, "crf": 20}),
        ({"video.codec": "h264", "video.preset": "x:stats=a", "video.crf": "1:stats=b", "video.g": -1}, {"g": 2}),
        ({"video.codec": "h264", "video.extra_options": X264}, {"g": 2}),
    ],
)
def test_an_encoder_gets_listed_options_only(info: dict[str, Any], options: dict[str, Any]) -> None:
    found = encoder_like(info).get_codec_options(1)
    assert set(found) <= {"g", "crf", "preset", "threads"}
    assert options.items() <= found.items()
    assert "stats" not in str(found)
    for codec in ("rawvideo", "libx264", None):
        with pytest.raises(DatasetError, match="re-encoded"):
            encoder_like({"video.codec": codec})


def test_no_option_of_a_dataset_reaches_the_encoder_that_joins_it(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also without the check: one place is not enough for a file of the user."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cutting, "_copied", lambda *_: None)
    row = pq.read_table(next((finished / "meta" / "episodes").rglob("*.parquet"))).slice(2, 1).to_pylist()[0]
    info = {"video.codec": "h264", "video.extra_options": {"x264-params": f"pass=1:stats={PROOF}"}}
    content = cutting.cut_episode(finished, schema.FRONT_IMAGE, {"info": info}, row, schema.FPS)
    (tmp_path / "cut.mp4").write_bytes(content)
    with av.open(str(tmp_path / "cut.mp4")) as film:
        assert sum(1 for _ in film.decode(video=0)) == row["length"]
    assert [path.name for path in tmp_path.iterdir()] == ["cut.mp4"]


def test_what_a_copy_does_not_know_it_does_not_carry_on(published: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(published, tmp_path / "other"))
    in_info(lambda info: info["features"]["action"].update(hook="x", fps=4))(root)
    assert check(root).clean
    filter_episodes(root, [], tmp_path / "copy")
    info = json.loads((tmp_path / "copy" / "meta" / "info.json").read_text())
    assert "hook" not in info["features"]["action"]


def test_a_title_is_no_formula(published: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(published, tmp_path / "other"))
    in_episodes("hidden_state", '{"a": "$\\\\frac{$"}')(root)
    assert main(["view", str(root), "--episode", "0", "--out", str(tmp_path / "picture.png")]) == 0
    assert np.fromfile(tmp_path / "picture.png", np.uint8).size > 1000
