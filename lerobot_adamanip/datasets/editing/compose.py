"""A new dataset out of episodes of others: the same rows, videos, per-episode columns and statistics, numbered anew.

LeRobot's own tools cannot: they fail on clouds, encode pictures again, and drop the columns of episodes that
they do not know.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.contract.schema import POINT_CLOUD
from lerobot_adamanip.datasets.appending import append_rows, can_append
from lerobot_adamanip.datasets.editing.cutting import cut_episode
from lerobot_adamanip.datasets.editing.recordings import describe_recording, require_same_calibrations
from lerobot_adamanip.datasets.editing.selection import Selection, write_selection
from lerobot_adamanip.datasets.editing.source import Rows, Source
from lerobot_adamanip.datasets.reading import read_back, workspace_of
from lerobot_adamanip.datasets.statistics import sort_statistics, write_episodes
from lerobot_adamanip.datasets.writing import cameras_json
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_adamanip.util.json_fields import parse

Progress = Callable[[int, int], None]
"""Told of episodes done, and all."""
_TOLD_WITH = ("meta/collection.json", "meta/attempts.jsonl")
"""Files that tell of the collection that the episodes of a part come from."""
_CAMERA = "camera"
Pieces = Sequence[tuple[Source, int]]
"""Datasets and indices of their episodes, in the order of the new dataset."""


def compose(
    out: Path, pieces: Pieces, repo_id: str, selection: Selection | None, progress: Progress = lambda done, total: None
) -> None:
    """Writes a dataset with these episodes, and reads it back.

    What it holds of another one (``selection``) brings along what is known of that one's collection.

    Args:
        out: a folder that does not exist.
        pieces: the episodes; one or more, of datasets with equal features.
        repo_id: for LeRobot.
        selection: what the new dataset is a part of, if of one.
        progress: told of episodes done, and all.

    Raises:
        DatasetError: a source is damaged.
        ConfigurationError: this LeRobot writes datasets otherwise.
    """
    sources = list(dict.fromkeys(source.root for source, _ in pieces))
    of = {source.root: source for source, _ in pieces}
    require_same_calibrations(list(of.values()))
    dataset = _create(out, [of[root] for root in sources], repo_id)
    _require_appendable(dataset)
    schema, rows, lengths = arrow_schema(dataset.meta.features), Rows(), []
    for done, (source, episode) in enumerate(pieces, start=1):
        lengths.append(_append(dataset, schema, rows, source, episode))
        files.crash_point("episode assembled")
        progress(done, len(pieces))
    dataset.finalize()
    files.crash_point("dataset written")
    _restore_info(out, [of[root] for root in sources])
    describe(out, pieces, selection)
    files.crash_point("dataset described")
    files.sync_tree(out)
    files.crash_point("dataset synced")
    read_back(out, lengths)
    files.crash_point("dataset verified")


def describe(out: Path, pieces: Pieces, selection: Selection | None) -> None:
    """Writes what a finished dataset of ours has beside what LeRobot writes.

    That is: statistics in a fixed order, its episodes' own columns, its cameras, and, if it is part of
    another one, which and how that was collected.

    Args:
        out: folder of the dataset.
        pieces: where its episodes come from, in its order.
        selection: what it is a part of, if of one.
    """
    sort_statistics(out)
    columns = pa.concat_tables(
        [source.own_columns.slice(episode, 1) for source, episode in pieces], promote_options="permissive"
    )
    _write_columns(out, columns)
    if cameras := _cameras(columns):
        files.write_atomically(out / "meta" / "cameras.json", cameras_json(cameras))
    describe_recording(out, pieces)
    if selection is not None:
        write_selection(out, selection)
        for name in _TOLD_WITH:
            if (pieces[0][0].root / name).is_file():
                files.write_atomically(out / name, (pieces[0][0].root / name).read_bytes())


def _require_appendable(dataset: Any) -> None:
    if not can_append(dataset):
        import lerobot

        raise ConfigurationError(
            "This LeRobot writes datasets otherwise.",
            got=f"lerobot {lerobot.__version__}",
            allowed="a version of docs/compatibility.md",
            hint="pip install 'lerobot==0.6.1'",
        )


def _create(out: Path, sources: Sequence[Source], repo_id: str) -> Any:
    import av
    import datasets
    from lerobot.configs.video import encoder_config_from_video_info
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.utils.constants import DEFAULT_FEATURES

    av.logging.set_libav_level(av.logging.ERROR)
    datasets.disable_progress_bars()
    info = sources[0].info
    given = {key: feature for key, feature in info["features"].items() if key not in DEFAULT_FEATURES}
    videos = [feature.get("info") for feature in given.values() if feature["dtype"] == "video"]
    dataset = LeRobotDataset.create(
        repo_id=repo_id,
        fps=info["fps"],
        features={key: {**feature, "shape": tuple(feature["shape"])} for key, feature in given.items()},
        root=out,
        robot_type=info.get("robot_type"),
        rgb_encoder=encoder_config_from_video_info(videos[0]) if videos else None,
        video_backend="pyav",
        video_files_size_in_mb=info.get("video_files_size_in_mb"),
        data_files_size_in_mb=info.get("data_files_size_in_mb"),
    )
    if info.get("chunks_size"):
        dataset.meta.update_chunk_settings(chunks_size=info["chunks_size"])
    return dataset


def _append(dataset: Any, schema: pa.Schema, rows: Rows, source: Source, episode: int) -> int:
    row = source.row(episode)
    table = rows.of(source, row)
    tasks = [source.tasks[index] for index in table["task_index"].to_pylist()]
    videos = {
        key: cut_episode(source.root, key, feature, row, source.info["fps"])
        for key, feature in dataset.meta.features.items()
        if feature["dtype"] == "video"
    }
    stats = source.stats(episode)
    return append_rows(dataset, with_types(table, schema), row["tasks"], tasks, stats=stats, videos=videos)


def arrow_schema(features: dict[str, Any]) -> pa.Schema:
    """Returns the types that LeRobot stores these features with."""
    from lerobot.datasets.feature_utils import get_hf_features_from_features

    return get_hf_features_from_features(features).arrow_schema


def with_types(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """Returns rows with these types, whoever wrote them: LeRobot's tools store the same values as other lists."""
    from datasets.table import table_cast

    if table.schema.equals(schema, check_metadata=True):
        return table
    plain = table.select(schema.names)
    return (plain if plain.schema.equals(schema) else table_cast(plain, schema)).replace_schema_metadata(
        schema.metadata
    )


def _restore_info(out: Path, sources: Sequence[Source]) -> None:
    """What LeRobot finds out about the new videos gives way to what is known of the old, where all sources agree."""
    path = out / "meta" / "info.json"
    info = json.loads(path.read_text(encoding="utf-8"))
    for key, feature in info["features"].items():
        told = [source.info["features"][key].get("info") or {} for source in sources]
        if any(told):
            feature["info"] = {
                name: value for name, value in told[0].items() if all(each.get(name) == value for each in told)
            }
    box = workspace_of(sources[0].root, sources[0].info["features"])
    if box != DEFAULT_WORKSPACE and POINT_CLOUD in info["features"]:  # a merged dataset has no manifest to tell it
        told = info["features"][POINT_CLOUD].setdefault("info", {})
        told["workspace"] = {"lower": list(box.lower), "upper": list(box.upper)}
    files.write_atomically(path, json.dumps(info, indent=4, ensure_ascii=False).encode())


def _cameras(columns: pa.Table) -> list[dict[str, Any]]:
    """Returns the camera's parameters in each episode; nothing if those of an episode are not known."""
    texts = columns[_CAMERA].to_pylist() if _CAMERA in columns.column_names else []
    try:
        cameras = [parse(text) for text in texts if isinstance(text, str)]
    except ValueError:
        return []
    return cameras if len(cameras) == len(columns) and all(isinstance(each, dict) for each in cameras) else []


def _write_columns(root: Path, columns: pa.Table) -> None:
    for path in sorted((root / "meta" / "episodes").glob("*/*.parquet")):
        table = pq.read_table(path)
        mine = columns.take(table["episode_index"])
        for name in mine.column_names:
            if name not in table.column_names:
                table = table.append_column(name, mine[name])
        write_episodes(path, table)
