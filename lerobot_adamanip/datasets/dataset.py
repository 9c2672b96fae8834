"""`Dataset`, the reader of every dataset on disk: key frames of `adamanip collect`, or a robot's recording of ticks.

    dataset = Dataset(root)                       # raises `DatasetError` for the first damage
    dataset = Dataset(root, on_damage=report.add) # reports each and continues, for `adamanip check`

- ``dataset.info``, ``.features``, ``.fps``, ``.tasks``, ``len(dataset)``: of ``meta/info.json`` and ``tasks.parquet``.
- ``dataset.table``: the columns of ``meta/episodes``, one per episode, without statistics; ``own_columns`` are ours.
- ``dataset.episodes``: `Episode`, its place and its row of that table. ``dataset.episode(3)`` checks the number.
- ``dataset.rows(episode)``: its rows as a table; ``columns(episode)`` as arrays; ``recorded(3, manifest)`` as
  `RecordedEpisode`, checked for the simulator.
- ``dataset.column_table(names)``: some columns of all rows.
- ``dataset.manifest(assets)``, ``.selection``, ``.workspace``, ``.statistics``: read on first access.
- ``EpisodeDescription.from_columns(episode.row)``: the description of an episode.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as pads
import pyarrow.parquet as pq
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import FRONT
from lerobot_adamanip.contract.memory import EVENTS, MEMORY, NO_MEMORY, SO_FAR, TEXT
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, Workspace
from lerobot_adamanip.datasets.collection_spec import columns_of, manifest_path
from lerobot_adamanip.datasets.dense import dense_contract, is_dense_collection
from lerobot_adamanip.datasets.encoding import PLACE
from lerobot_adamanip.datasets.episode import EpisodeDescription
from lerobot_adamanip.datasets.manifest import Manifest, read_manifest
from lerobot_adamanip.datasets.opening import (
    DATA_PATH,
    TASK,
    VIDEO_PATH,
    UntrustedValueError,
    as_typed,
    check_episode_text,
    check_video,
    checked_info,
    damaged,
    first_line,
    recording_error,
    untrusted,
)
from lerobot_adamanip.datasets.selection import Selection, read_selection
from lerobot_adamanip.datasets.shards import RecordedEpisode
from lerobot_adamanip.hardware.features import is_dense
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.json_fields import integer, number, read
from lerobot_adamanip.util.video import open_mp4

STATS, TASKS = "meta/stats.json", "meta/tasks.parquet"
MAX_STATISTICS_BYTES = 100_000_000
OnDamage = Callable[[str, str, str | None, int | None], object]
"""Called with kind of damage (of `check.findings.KINDS`), message, file and episode."""
_OF_LEROBOT = ("episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index", "listed_in")
_OF_LEROBOT_PREFIXES = ("data/", "videos/", "meta/")
_INDEX, _TIME = integer(0, 2**40), number(0, 1e9)


class VideoPart(NamedTuple):
    """Place of an episode's frames: path within the dataset, and times within the file [s]."""

    file: str
    start: float
    end: float


@dataclass(frozen=True)
class Episode:
    """An episode of a dataset.

    Attributes:
        number: its index.
        length: number of rows.
        tasks: texts.
        file: path of its rows within the dataset.
        start, end: its range of the dataset's rows, ``end`` excluded.
        videos: column -> its frames.
        listed_in: file of ``meta/episodes`` with its row.
        row: its columns there, as stored, without statistics.
    """

    number: int
    length: int
    tasks: tuple[str, ...]
    file: str
    start: int
    end: int
    videos: Mapping[str, VideoPart]
    listed_in: str
    row: Mapping[str, Any]


class Dataset:
    """A dataset on disk. Everything but ``meta/info.json`` is read when it is needed.

    Args:
        root: its folder.
        recordings: also accept a robot's recording, whose rows are ticks without clouds.
        on_damage: called for each damage, which is then skipped. By default the first one raises.

    Raises:
        DatasetError: it is missing, has another format, or its ``meta/info.json`` is damaged. Without ``on_damage``
            also if it is half written (no Parquet footer, missing rows or videos), or a column of the contract is
            missing or has another shape.
    """

    def __init__(
        self,
        root: str | Path,
        *,
        recordings: bool = False,
        on_damage: OnDamage | None = None,
    ) -> None:
        self.root = Path(root).absolute()
        self.info = checked_info(self.root)
        self._files: dict[str, pads.Dataset] = {}
        self._damage: OnDamage = on_damage or self._raise
        if on_damage is None:
            self._require_complete()
            if not is_dense(self.features):
                self._require_columns()
            elif not recordings:
                raise recording_error(self.root, self.features)

    def __len__(self) -> int:
        return int(self.info["total_episodes"])

    @property
    def features(self) -> dict[str, dict[str, Any]]:
        """Columns, in LeRobot's description."""
        features: dict[str, dict[str, Any]] = self.info["features"]
        return features

    @property
    def fps(self) -> int:
        """Rows per second."""
        return int(self.info["fps"])

    def keys_of(self, *dtypes: str) -> list[str]:
        """Returns the columns of the given types."""
        return [key for key, feature in self.features.items() if feature["dtype"] in dtypes]

    @property
    def workspace(self) -> Workspace:
        """Workspace of the clouds."""
        return workspace_of(self.root, self.features)

    @property
    def memory(self) -> str:
        """Memory of felt tries, of `contract.memory.MEMORIES`.

        Tasks without a sentence do not exclude ``text``: the sentence begins with the first felt try.
        """
        if MEMORY in self.features:
            return EVENTS
        is_text = _manifest_environment(self.root).get("memory") == TEXT
        return TEXT if is_text or any(SO_FAR in task for task in self.tasks.values()) else NO_MEMORY

    @cached_property
    def tasks(self) -> dict[int, str]:
        """Index -> text of a task; empty if they cannot be read."""
        try:
            content = pq.read_table(self.root / TASKS).to_pydict()
            texts = next(values for key, values in content.items() if key != "task_index")
            tasks = {int(index): str(text) for index, text in zip(content["task_index"], texts, strict=True)}
        except FileNotFoundError:
            self._damage("missing", "texts of the tasks", TASKS, None)
            return {}
        except (OSError, ValueError, TypeError, KeyError, StopIteration, pa.ArrowException) as error:
            self._damage("unreadable", first_line(error), TASKS, None)
            return {}
        for text in tasks.values():
            try:
                TASK("a task", text)
            except ValueError as error:
                self._damage("untrusted", str(error), TASKS, None)
        return tasks

    # Episodes ---------------------------------------------------------------------------------------------------------

    @cached_property
    def table(self) -> pa.Table:
        """Columns of ``meta/episodes``, without statistics, ordered by episode; ``listed_in`` has the file of each."""
        return self._episode_files(lambda name: not name.startswith("stats/"))

    @cached_property
    def statistics(self) -> pa.Table:
        """Columns of statistics of ``meta/episodes``, in the order of `table`; never those of clouds.

        LeRobot's tools write statistics of each coordinate of a cloud, which are most of the file.
        """
        cloud = f"stats/{schema.POINT_CLOUD}/"
        table = self._episode_files(
            lambda name: name == "episode_index" or (name.startswith("stats/") and not name.startswith(cloud))
        )
        return table.drop_columns(["episode_index", "listed_in"])

    def _episode_files(self, is_wanted: Callable[[str], bool]) -> pa.Table:
        tables = []
        for path in sorted((self.root / "meta" / "episodes").glob("*/*.parquet")):
            name = path.relative_to(self.root).as_posix()
            try:
                if not {"episode_index", "length"} <= set(names := pq.read_schema(path).names):
                    raise KeyError("the file does not list episodes")
                table = pq.read_table(path, columns=[each for each in names if is_wanted(each)])
                table = table.replace_schema_metadata(None)
                tables.append(table.append_column("listed_in", pa.array([name] * len(table), pa.string())))
            except (OSError, KeyError, pa.ArrowException) as error:
                self._damage("unreadable", first_line(error), name, None)
        if not tables:
            return pa.table({"episode_index": pa.array([], pa.int64()), "listed_in": pa.array([], pa.string())})
        return pa.concat_tables(tables, promote_options="permissive").sort_by("episode_index")

    @cached_property
    def row_of(self) -> dict[int, int]:
        """Index of an episode -> its row in `table`."""
        return {number: row for row, number in enumerate(self.table["episode_index"].to_pylist())}

    @cached_property
    def own_columns(self) -> pa.Table:
        """Columns of `table` that are not LeRobot's."""
        names = (name for name in self.table.column_names if name not in _OF_LEROBOT)
        return self.table.select([name for name in names if not name.startswith(_OF_LEROBOT_PREFIXES)])

    @cached_property
    def episodes(self) -> list[Episode]:
        """All episodes, in order, without those whose metadata are damaged."""
        videos, episodes = self.keys_of("video"), []
        for row in self.table.to_pylist():
            place = row["listed_in"], row["episode_index"]
            try:
                episodes.append(_episode(row, videos))
            except (KeyError, TypeError, ValueError) as error:
                self._damage("metadata", f"missing or invalid: {error}", *place)
            for name, value in row.items():
                try:
                    check_episode_text(name, value)
                except UntrustedValueError as error:
                    self._damage("untrusted", str(error)[:200], *place)
        return episodes

    def episode(self, index: int) -> Episode:
        """Returns an episode; raises `ConfigurationError` if there is none with this index."""
        if not 0 <= index < len(self.episodes):
            allowed = f"0 to {len(self.episodes) - 1}"
            raise ConfigurationError("No such episode.", got=index, allowed=allowed, hint="--episode 0")
        return self.episodes[index]

    def descriptions(self) -> list[EpisodeDescription]:
        """Returns each episode's description; raises `DatasetError` if some are missing or invalid."""
        try:
            return [EpisodeDescription.from_columns(episode.row) for episode in self.episodes]
        except (TypeError, ValueError) as error:
            raise DatasetError(
                "The episodes do not say how they were made.",
                got=f"{self.root.name}: {error}",
                allowed="the columns that `adamanip collect` writes into meta/episodes",
                hint="a dataset of `adamanip collect`",
            ) from error

    @cached_property
    def _statistics(self) -> dict[str, NDArray[Any] | pa.ChunkedArray]:
        """Columns of statistics, as arrays where every episode has them."""
        columns = {name: self.statistics[name] for name in self.statistics.column_names}
        arrays = {name: numeric_array(column) for name, column in columns.items()}
        return {name: column if arrays[name] is None else arrays[name] for name, column in columns.items()}

    def statistics_of(self, index: int) -> dict[str, dict[str, Any]]:
        """Returns an episode's stored statistics, column -> name -> array."""
        statistics: dict[str, dict[str, Any]] = {}
        for name, column in self._statistics.items():
            key, _, statistic = name.removeprefix("stats/").rpartition("/")
            cell = column[index : index + 1]
            values = cell if isinstance(cell, np.ndarray) else numeric_array(cell)
            if values is not None and key not in PLACE:
                statistics.setdefault(key, {})[statistic] = values[0]
        return statistics

    # Rows -------------------------------------------------------------------------------------------------------------

    def rows(self, episode: Episode) -> pa.Table:
        """Returns the rows of an episode; raises `DatasetError` if any are missing."""
        problem: object = f"its rows are not where they should be in {episode.file}"
        try:
            file = self._files.get(episode.file) or pads.dataset(self.root / episode.file, format="parquet")
            self._files[episode.file] = file
            # LeRobot and this project write an episode as one row group, so only that one is read.
            table = file.to_table(filter=pc.field("episode_index") == episode.number)
            if table["index"].to_pylist() == list(range(episode.start, episode.end)):
                return table
        except (OSError, pa.ArrowException) as error:
            problem = error
        raise DatasetError(
            "Rows of a dataset cannot be read.",
            got=f"{self.root}, episode {episode.number}: {problem}",
            allowed="consecutive rows of each episode",
            hint=f"adamanip check {as_typed(self.root)}",
        )

    def columns(self, episode: Episode) -> dict[str, NDArray[Any]]:
        """Returns the rows of an episode as arrays, without columns of text and columns with empty cells."""
        table = self.rows(episode)
        arrays = {name: numeric_array(table[name]) for name in table.column_names}
        return {name: values for name, values in arrays.items() if values is not None}

    def recorded(self, index: int, manifest: Manifest) -> RecordedEpisode:
        """Returns an episode of a collection, without images; raises `DatasetError` for invalid values.

        ``record`` has the fields of `EpisodeDescription` and ``task``; also ``tasks``, one a row, if they differ.
        """
        episode = self.episode(index)
        try:
            description = EpisodeDescription.from_columns(episode.row)
            if description.object_id not in manifest.spec.objects:
                raise ValueError("object_id is none of the collection's")
            integer(2, 10_000)("length", episode.length)
            arrays, columns = self.columns(episode), {}
            for key, feature in columns_of(manifest.spec.environment.changed(observe_images=False)).items():
                values = arrays[key].astype(feature["dtype"], copy=False)
                columns[key] = values.reshape(episode.length, *feature["shape"])
            tasks = [self.tasks[index] for index in arrays["task_index"].tolist()]
            more = {"tasks": tasks} if len(set(tasks)) > 1 else {}
            return RecordedEpisode(columns, description.record(tasks[0]) | more)
        except (ValueError, KeyError, TypeError) as error:
            raise DatasetError(
                "An episode of the dataset has invalid values.",
                got=f"episode {index} of {self.root}: {error}",
                allowed="rows as `adamanip collect` writes them",
                hint=f"to see all damage: adamanip check {as_typed(self.root)}; other episodes can be read",
            ) from error

    def column_table(self, names: Iterable[str]) -> pa.Table:
        """Returns some columns of all rows, ordered by ``index``; raises `DatasetError` for a damaged file."""
        selected = list(dict.fromkeys(("index", "episode_index", *names)))
        try:
            return pq.read_table(sorted(self.root.glob("data/*/*.parquet")), columns=selected).sort_by("index")
        except (OSError, pa.ArrowException) as error:
            raise damaged(self.root, first_line(error)) from error

    # Files beside -----------------------------------------------------------------------------------------------------

    def manifest(self, assets: str | Path | None = None) -> Manifest:
        """Returns the manifest of a collection; ``assets`` is the folder of external assets, if it used any.

        Raises:
            DatasetError: there is none, it is damaged, or ``assets`` does not fit.
        """
        return read_manifest(manifest_path(self.root), assets)

    @cached_property
    def selection(self) -> Selection:
        """Source episodes of this part of a dataset; all its own episodes if it is not a part."""
        return read_selection(self.root, len(self))

    def _raise(self, kind: str, message: str, file: str | None, episode: int | None) -> NoReturn:
        place = ", ".join(filter(None, (file, None if episode is None else f"episode {episode}")))
        raise (untrusted if kind == "untrusted" else damaged)(self.root, f"{place}: {message}")

    def _require_complete(self) -> None:
        """Raises `DatasetError` if statistics, rows, episodes or videos are missing, half written or no MP4 files."""
        try:
            read(self.root / STATS, max_bytes=MAX_STATISTICS_BYTES)
        except (OSError, ValueError) as error:
            raise damaged(self.root, f"{STATS}: {error}") from error
        for pattern, total in (("data/*/*.parquet", "total_frames"), ("meta/episodes/*/*.parquet", "total_episodes")):
            rows = 0
            for path in self.root.glob(pattern):
                try:
                    rows += pq.read_metadata(path).num_rows
                except (OSError, pa.ArrowException) as error:
                    raise damaged(self.root, f"{path.relative_to(self.root)}: {error}") from error
            if rows == 0 or rows != self.info[total]:
                raise damaged(self.root, f"{rows} rows in {pattern}, but {total} = {self.info[total]}")
        for key in self.keys_of("video"):
            if not any((self.root / "videos" / key).glob("*/*.mp4")):
                raise damaged(self.root, f"no videos of {key}")
        try:
            for path in self.root.glob("videos/*/*/*.mp4"):
                check_video(path)
        except UntrustedValueError as error:
            raise untrusted(self.root, error) from error

    def _require_columns(self) -> None:
        shapes = {key: tuple(feature["shape"]) for key, feature in self.features.items()}
        cloud = shapes.get(schema.POINT_CLOUD, ())
        points = cloud[0] // 3 if cloud and cloud[0] % 3 == 0 else schema.DEFAULT_NUM_POINTS
        contract = schema.dataset_features(points)
        if is_dense_collection(self.features):
            contract = dense_contract(self.features)
        for key in (schema.POINT_CLOUD, schema.STATE, schema.ACTION):
            if key in contract and shapes.get(key) != (right := tuple(contract[key]["shape"])):
                raise DatasetError(
                    f"Column {key} does not fit.",
                    got=f"shape {shapes.get(key, 'missing')} in {self.root}",
                    allowed=f"shape {right}",
                    hint=f"adamanip collect DIR --num-points {points}, or another dataset",
                )


def _episode(row: Mapping[str, Any], videos: Iterable[str]) -> Episode:
    def index(name: str) -> int:
        return int(_INDEX(name, row[name]))

    def file(template: str, prefix: str, **names: str) -> str:
        return template.format(**names, **{name: index(f"{prefix}/{name}") for name in ("chunk_index", "file_index")})

    def part(key: str) -> VideoPart:
        prefix = f"videos/{key}"
        start, end = (float(_TIME(name, row[name])) for name in (f"{prefix}/from_timestamp", f"{prefix}/to_timestamp"))
        return VideoPart(file(VIDEO_PATH, prefix, video_key=key), start, end)

    return Episode(
        number=index("episode_index"),
        length=index("length"),
        tasks=tuple(row["tasks"]),
        file=file(DATA_PATH, "data"),
        start=index("dataset_from_index"),
        end=index("dataset_to_index"),
        videos={key: part(key) for key in videos},
        listed_in=row["listed_in"],
        row=row,
    )


def open_dataset(root: str | Path, **options: Any) -> Any:
    """Returns a checked ``LeRobotDataset``; passes ``options`` on (``episodes``, ``delta_timestamps``, ...)."""
    folder = Dataset(root).root
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset(f"local/{folder.name}", root=folder, **options)


def read_back(root: str | Path, lengths: Iterable[int] | None = None) -> None:
    """Reads a whole dataset: all rows and all video frames.

    Raises:
        DatasetError: anything is missing or unreadable, or the episodes' numbers of rows differ from ``lengths``.
    """
    dataset = Dataset(root, recordings=True)
    stored = dataset.table["length"].to_pylist()
    try:
        rows = sum(pq.read_table(path).num_rows for path in dataset.root.glob("data/*/*.parquet"))
        frames = {
            key: sum(_decoded(path) for path in (dataset.root / "videos" / key).glob("*/*.mp4"))
            for key in dataset.keys_of("video")
        }
    except (OSError, ValueError, pa.ArrowException) as error:
        raise damaged(dataset.root, error) from error
    written = stored if lengths is None else list(lengths)
    if stored != written or any(count != sum(written) for count in (rows, *frames.values())):
        counts = f"{len(stored)} episodes, {rows} rows, frames {frames}"
        raise damaged(dataset.root, f"{counts}; {sum(written)} were written")


def _decoded(path: Path) -> int:
    with contextlib.closing(open_mp4(path)) as container:
        return sum(1 for _ in container.decode(video=0))


def workspace_of(root: Path, features: Mapping[str, Any]) -> Workspace:
    """Returns the workspace of a dataset's clouds: from the manifest, the column's description, or the default."""
    box: Any = (features.get(schema.POINT_CLOUD, {}).get("info") or {}).get("workspace")
    box = _manifest_environment(root).get("workspace", box)
    try:
        return DEFAULT_WORKSPACE if box is None else Workspace(tuple(box["lower"]), tuple(box["upper"]))
    except (KeyError, TypeError, ValueError):
        return DEFAULT_WORKSPACE


def _manifest_environment(root: Path) -> dict[str, Any]:
    """Returns the environment of a dataset's manifest, unchecked; empty if there is none or it is damaged."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # `read_manifest` reports errors
        return dict(read(manifest_path(root))["collection"]["environment"])
    return {}


def camera_of(features: Mapping[str, Any]) -> str:
    """Returns the key of the camera whose depth became a dataset's clouds; a dataset names it if it is not `FRONT`."""
    return str((features.get(schema.POINT_CLOUD, {}).get("info") or {}).get("camera", FRONT))
