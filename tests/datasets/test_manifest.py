"""Datasets of others: nothing in them is imported, called or used as a path; what cannot be is one clear error."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from demos_helpers import fakes, make_spec

from lerobot_adamanip.collection.replay import replay
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.manifest import Manifest, read_manifest, require_same, write_manifest
from lerobot_adamanip.util.errors import AdaManipError, DatasetError

Refuses = Callable[[type, Callable[[], Any]], str]
VERSIONS = {"simulation": "3", "torch": "2.11.0", "renderer": "llvmpipe (LLVM 19.1.7, 256 bits)"}


def test_a_manifest_survives_the_disk(tmp_path: Path) -> None:
    wanted = Manifest(make_spec(hidden_overrides={"locked": True, "knob_range": 0.5}, poses="fixed"), VERSIONS)
    write_manifest(tmp_path / "m", wanted)
    assert read_manifest(tmp_path / "m") == wanted


def test_it_holds_no_path(tmp_path: Path) -> None:
    text = json.dumps(Manifest(make_spec(), VERSIONS).to_json())
    for word in ('assets": "', "/", "episode_log", "factory"):
        assert word not in text


def test_differences_are_named(tmp_path: Path, refuses: Refuses) -> None:
    stored, wanted = Manifest(make_spec()), Manifest(make_spec(seed=1, num_points=9))
    message = refuses(DatasetError, lambda: require_same(stored, wanted, tmp_path))
    assert ("num_points = 9" in message, "seed = 1" in message, "image_size" in message) == (True, True, False)
    require_same(stored, Manifest(make_spec()), tmp_path)


def test_other_versions_are_refused_and_named(tmp_path: Path, refuses: Refuses) -> None:
    stored = Manifest(make_spec(), VERSIONS)
    without = {name: version for name, version in VERSIONS.items() if name != "torch"}
    for name, versions in (("simulation", {**VERSIONS, "simulation": "4"}), ("torch", without)):
        wanted = Manifest(make_spec(), versions)
        message = refuses(DatasetError, lambda wanted=wanted: require_same(stored, wanted, tmp_path))
        assert f"other versions: {name} differ" in message


@pytest.fixture
def canary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module that notes that it was imported or called, where imports look for modules."""
    folder = tmp_path / "importable"
    folder.mkdir()
    note = folder / "executed"
    (folder / "adamanip_canary.py").write_text(
        f"from pathlib import Path\nPath({str(note)!r}).touch()\ndef run(*args, **kwargs):\n    raise SystemExit\n"
    )
    monkeypatch.syspath_prepend(str(folder))
    return note


def nested(depth: int) -> Any:
    value: Any = 1
    for _ in range(depth):
        value = [value]
    return value


CODE = "adamanip_canary:run"
Change = Callable[[dict[str, Any]], Any]


def put(*path: str, value: Any) -> Change:
    """Sets a field, in depth."""

    def change(content: dict[str, Any]) -> None:
        for name in path[:-1]:
            content = content[name]
        content[path[-1]] = value

    return change


HOSTILE: dict[str, Change] = {
    "code instead of an environment": put("env_factory", value=CODE),
    "code among the options": put("collection", "expert_factory", value=CODE),
    "code among the environment's": put("collection", "environment", "factory", value=CODE),
    "code as an expert": put("collection", "expert", value=CODE),
    "another category": put("category", value="lamp"),
    "an object of another category": put("collection", "objects", value=["safe_000", "lamp_000"]),
    "an object that is a path": put("collection", "objects", value=["../../../etc/passwd"]),
    "external objects without hashes": put("collection", "objects", value=["safe:sa1"]),
    "a path of assets": put("collection", "environment", "assets", value="/etc"),
    "a path of a log": put("collection", "environment", "episode_log", value="/tmp/adamanip-hostile"),
    "hashes of what is not there": put("external_assets", value={"safe:sa1": "0" * 32}),
    "no objects": put("collection", "objects", value=[]),
    "objects twice": put("collection", "objects", value=["safe_000", "safe_000"]),
    "too many objects": put("collection", "objects", value=[f"safe_{n:03d}" for n in range(6000)]),
    "an absurd number of points": put("collection", "environment", "num_points", value=10**12),
    "an image size that is no number": put("collection", "environment", "image_size", value="256"),
    "not a number": put("collection", "late_starts", value=float("nan")),
    "infinity": put("collection", "environment", "workspace", "upper", value=[float("inf")] * 3),
    "a workspace of two": put("collection", "environment", "workspace", "lower", value=[0.0, 0.0]),
    "an inverted workspace": put("collection", "environment", "workspace", "lower", value=[9.0, 9.0, 9.0]),
    "a negative seed": put("collection", "seed", value=-1),
    "a number of 400 digits": put("collection", "trials", value=10**400),
    "too many episodes": put("collection", "episodes_per_object", value=10**8),
    "hidden values that are code": put("collection", "environment", "hidden_overrides", value={"__class__": CODE}),
    "nested values": put("collection", "trials", value=nested(500)),
    "nested beyond measure": put("versions", value="DEEP"),
    "an unknown field": put("surprise", value=1),
    "a missing field": lambda content: content.pop("versions"),
    "a format to come": put("format", value=4),
    "counts that are negative": put("attempts", value={"kept": -1, "attempted": 1, "given_up": 0}),
    "a version with a new line": put("versions", value={"a": "b\n# evil"}),
}
TEXTS: dict[str, str | bytes] = {
    "nothing": "", "a list": "[]", "an empty object": "{}", "no JSON": "{'format': 2}", "binary": b"\x80\x04\x95\xff",
    "a field twice": '{"format": 2, "format": 2}', "huge": '{"format": 2' + " " * 9_000_000 + "}",
}  # fmt: skip


@pytest.fixture
def copy(tmp_path: Path, finished: Path) -> Path:
    """A dataset that a test may change."""
    return Path(shutil.copytree(finished, tmp_path / "data" / "copy"))


def everything(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if "__pycache__" not in path.parts}


def refused(root: Path, canary: Path, refuses: Refuses) -> str:
    """Replays what nobody should; returns the error. Nothing may be built, executed or written."""
    built = canary.with_name("built")
    before = everything(root.parent)
    message = refuses(AdaManipError, lambda: replay(root, 0, fakes(built=built).environment))
    assert everything(root.parent) == before
    assert not built.exists()
    assert not canary.exists()
    assert "adamanip_canary" not in sys.modules
    assert not Path("/tmp/adamanip-hostile").exists()
    assert len(message) < 2000
    return message


@pytest.fixture
def manifest(tmp_path: Path) -> dict[str, Any]:
    """Content of a sound manifest."""
    write_manifest(tmp_path / "sound", Manifest(make_spec(), VERSIONS))
    return dict(json.loads((tmp_path / "sound").read_text()))


@pytest.mark.parametrize("name", [*HOSTILE, *TEXTS])
def test_a_hostile_or_damaged_manifest_is_one_clear_error(
    manifest: dict[str, Any], canary: Path, tmp_path: Path, refuses: Refuses, name: str
) -> None:
    if name in HOSTILE:
        HOSTILE[name](manifest)
    deep = json.dumps(manifest).replace('"DEEP"', "[" * 50_000 + "]" * 50_000)
    text = TEXTS.get(name, deep)
    (tmp_path / "m").write_bytes(text if isinstance(text, bytes) else text.encode())
    message = refuses(AdaManipError, lambda: read_manifest(tmp_path / "m"))
    assert len(message) < 2000
    assert not canary.exists()
    assert "adamanip_canary" not in sys.modules


def test_a_replay_of_a_hostile_manifest_does_nothing(copy: Path, canary: Path, refuses: Refuses) -> None:
    path = manifest_path(copy)
    content = json.loads(path.read_text())
    HOSTILE["code as an expert"](content)
    path.write_text(json.dumps(content))
    assert "manifest" in refused(copy, canary, refuses)


ROWS: dict[str, tuple[str, Any]] = {
    "another object": ("object_id", "safe_035"),
    "an object that is a path": ("object_id", "../../etc"),
    "a start that is code": ("start", '{"actions": "adamanip_canary:run"}'),
    "a start of too many actions": ("start", json.dumps({"actions": [[0.0] * 10] * 100})),
    "a start that is far away": ("start", json.dumps({"actions": [[1e9] * 10]})),
    "hidden values that are code": ("hidden_overrides", '{"locked": "os.system(1)"}'),
    "a negative seed": ("seed", -5),
    "a seed of text": ("seed", "17"),
    "rows of nowhere": ("dataset_from_index", 10**9),
    "rows without end": ("length", 10**9),
}


@pytest.mark.parametrize("name", ROWS)
def test_a_hostile_episode_is_one_clear_error(copy: Path, canary: Path, refuses: Refuses, name: str) -> None:
    column, value = ROWS[name]
    path = copy / "meta/episodes/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    values = [value] * table.num_rows
    pq.write_table(table.set_column(table.column_names.index(column), column, pa.array(values)), path)
    refused(copy, canary, refuses)


INFO: dict[str, Change] = {
    "data elsewhere": put("data_path", value="../../../../etc/{chunk_index}/{file_index}"),
    "a column that is a path": lambda info: info["features"].update({"../../x": info["features"]["action"]}),
    "a column of absurd size": put("features", "action", "shape", value=[10**15]),
    "a column without a shape": lambda info: info["features"]["action"].pop("shape"),
    "frames that are text": put("total_frames", value="many"),
}


@pytest.mark.parametrize("name", INFO)
def test_hostile_metadata_are_one_clear_error(copy: Path, canary: Path, refuses: Refuses, name: str) -> None:
    path = copy / "meta" / "info.json"
    info = json.loads(path.read_text())
    INFO[name](info)
    path.write_text(json.dumps(info))
    refuses(DatasetError, lambda: Dataset(copy))
    refused(copy, canary, refuses)


def test_external_assets_are_asked_for_and_checked(tmp_path: Path, refuses: Refuses) -> None:
    assets = tmp_path / "assets"
    (assets / "safe" / "sa1" / "meshes").mkdir(parents=True)
    (assets / "safe" / "sa1" / "mobility.urdf").write_text("<robot/>")
    (assets / "safe" / "sa1" / "meshes" / "door.obj").write_text("v 0 0 0")
    used = Manifest.of(make_spec(objects=("safe:sa1",), assets=str(assets)), {})
    write_manifest(tmp_path / "m", used)
    text = (tmp_path / "m").read_text()
    assert str(tmp_path) not in text
    assert read_manifest(tmp_path / "m", assets) == used
    assert "external" in refuses(DatasetError, lambda: read_manifest(tmp_path / "m"))
    write_manifest(tmp_path / "n", Manifest(make_spec()))
    assert "generated" in refuses(DatasetError, lambda: read_manifest(tmp_path / "n", assets))
    moved = Path(shutil.move(assets, tmp_path / "elsewhere"))  # the place may change, the content not
    again = Manifest.of(make_spec(objects=("safe:sa1",), assets=str(moved)), {})
    require_same(read_manifest(tmp_path / "m", moved), again, tmp_path)
    (moved / "safe" / "sa1" / "meshes" / "door.obj").write_text("v 1 0 0")
    other = Manifest.of(make_spec(objects=("safe:sa1",), assets=str(moved)), {})
    assert "safe:sa1 differ" in refuses(DatasetError, lambda: require_same(used, other, tmp_path))
