"""Converts dense recordings to a dataset of demonstrations, alone or mixed with simulated datasets."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

import lerobot_adamanip
from lerobot_adamanip.collection.assemble import append_shards
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.datasets.dataset import Dataset, read_back
from lerobot_adamanip.datasets.editing import merge_into, one_workspace
from lerobot_adamanip.datasets.episode import to_json
from lerobot_adamanip.datasets.opening import read_info
from lerobot_adamanip.datasets.output_folder import CONVERTING, owned_output
from lerobot_adamanip.datasets.pose_statistics import keep_unscaled_poses
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.datasets.shards import RecordedEpisode, read_record, write_shard
from lerobot_adamanip.datasets.statistics import write_statistics
from lerobot_adamanip.datasets.writing import add_episode_columns, cameras_json, create_dataset
from lerobot_adamanip.hardware.camera_frames import CameraCalibration
from lerobot_adamanip.hardware.features import FRONT_CAMERA, INTERVENTION
from lerobot_adamanip.recordings.keyframe_choice import DenseEpisode, choose_key_frames
from lerobot_adamanip.recordings.recording import DenseRecording
from lerobot_adamanip.recordings.rows import RowOptions, camera_record, demonstration_columns
from lerobot_adamanip.recordings.sparsify import KeyFrameOptions
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

Progress = Callable[[str, int, int], None]
"""Called with stage (``convert``, ``assemble``, ``merge``), finished episodes and total episodes."""
_LEAST_TICKS = 2


@dataclass(frozen=True)
class ConvertOptions:
    """Options of a conversion.

    Attributes:
        key_frames: thresholds of key frames.
        rows: points, images and workspace; a mix takes them from its simulated datasets.
        camera: key of the camera whose depth becomes the cloud.
        calibration: camera calibration file; None uses the file in each recording.
        successful: whether episodes count as successful at their last row, in recordings without a reported success.
            Of interventions, only one that lasts to the end of its episode counts.
        skip_still: whether to skip episodes without motion instead of raising an error.
        repo_id: dataset name; default ``local/<folder name>``.
    """

    key_frames: KeyFrameOptions = field(default_factory=KeyFrameOptions)
    rows: RowOptions = field(default_factory=RowOptions)
    camera: str = FRONT_CAMERA
    calibration: Path | None = None
    successful: bool = False
    skip_still: bool = False
    repo_id: str | None = None


@dataclass(frozen=True)
class Converted:
    """Result of a conversion.

    Attributes:
        episodes: number of episodes from recordings.
        ticks: number of their recorded ticks.
        key_frames: number of their key frames.
        simulated: number of episodes from simulated datasets.
        skipped: episodes without motion, as ``recording:episode``.
    """

    episodes: int
    ticks: int
    key_frames: int
    simulated: int
    skipped: tuple[str, ...]


def convert(
    sources: Sequence[Path],
    out: Path,
    options: ConvertOptions | None = None,
    progress: Progress = lambda stage, done, total: None,
) -> Converted:
    """Writes one dataset: the key frames of dense recordings, then the episodes of simulated datasets.

    ``out`` appears only when it is complete.

    Args:
        sources: one or more dense recordings, and any simulated datasets.
        out: new folder; it must not exist.
        options: options of the conversion.
        progress: called after each episode.

    Raises:
        DatasetError: a source is missing, damaged or of another kind, an episode has no motion, or ``out`` exists.
        ConfigurationError: the sources contain no dense recording.
    """
    require_repo_id(options.repo_id if options else None)
    with owned_output(out, CONVERTING) as output:
        output.require_free()
        output.require_room()
        simulated = [each for each in sources if _is_demonstrations(each)]
        chosen = _fitting(options or ConvertOptions(), simulated)
        recordings = [DenseRecording.open(each, chosen.camera) for each in sources if each not in simulated]
        if not recordings:
            raise ConfigurationError(
                "There is no dense recording.",
                got=", ".join(each.name for each in sources) or "nothing",
                allowed="one or more recordings of `lerobot-record`",
                hint="a dataset of key frames needs no conversion; adamanip merge joins several",
            )
        output.fresh("episodes").mkdir()
        conversion = _Conversion(output.work, chosen, progress)
        shards = list(conversion.shards(recordings))
        repo_id = chosen.repo_id or f"local/{output.root.name}"
        built, merged = _assembled(output.fresh("dataset"), shards, chosen, repo_id, progress), 0
        keep_unscaled_poses(built, [Dataset(each, recordings=True) for each in sources if each not in simulated])
        if simulated:
            parts, built = [built, *simulated], output.fresh("merged")
            merged = merge_into(built, parts, repo_id, functools.partial(progress, "merge")).episodes - len(shards)
        output.publish(built)
    return Converted(len(shards), conversion.ticks, conversion.key_frames, merged, tuple(conversion.skipped))


def _is_demonstrations(root: Path) -> bool:
    try:
        return schema.POINT_CLOUD in read_info(root.absolute())["features"]
    except (OSError, ValueError):
        return False  # `DenseRecording.open` reports the error


def _fitting(options: ConvertOptions, simulated: Sequence[Path]) -> ConvertOptions:
    """Returns options with the columns of the simulated datasets, if any."""
    if not simulated:
        return options
    datasets = [Dataset(each) for each in simulated]
    box = one_workspace(datasets)
    if options.rows.workspace not in (box, DEFAULT_WORKSPACE):
        raise ConfigurationError(
            "All clouds of a mix need the same workspace.",
            got=f"{options.rows.workspace}",
            allowed=f"{box}, as in {simulated[0].name}",
            hint="leave out --workspace-lower and --workspace-upper",
        )
    features = datasets[0].features
    image = features.get(schema.FRONT_IMAGE)
    rows = replace(
        options.rows,
        workspace=box,
        num_points=int(features[schema.POINT_CLOUD]["shape"][0]) // 3,
        image_size=None if image is None else int(image["shape"][0]),
    )
    return replace(options, rows=rows)


@dataclass
class _Conversion:
    """Writes shards of recordings and counts episodes."""

    work: Path
    options: ConvertOptions
    progress: Progress
    ticks: int = 0
    key_frames: int = 0
    skipped: list[str] = field(default_factory=list)

    def shards(self, recordings: Sequence[DenseRecording]) -> Iterator[Path]:
        """Writes the shards of all recordings and yields their paths in order."""
        done, total = 0, sum(map(len, recordings))
        for recording in recordings:
            calibration = recording.calibration(self.options.calibration)
            for number in range(len(recording)):
                if self.options.calibration is None:
                    calibration = recording.calibration_of(number, calibration)
                episode = recording.episode(number)
                if self.options.successful and not recording.has_success:
                    episode = replace(episode, success=np.arange(len(episode)) == len(episode) - 1)
                for begin, part in _parts(episode):
                    converted = self._converted(recording, number, begin, part, calibration)
                    if converted is not None:
                        path = self.work / "episodes" / f"{done:06d}-{begin:06d}.safetensors"
                        write_shard(path, converted)
                        yield path
                done += 1
                self.progress("convert", done, total)

    def _converted(
        self, recording: DenseRecording, number: int, begin: int, episode: DenseEpisode, calibration: CameraCalibration
    ) -> RecordedEpisode | None:
        """Returns the demonstration of a part that starts at a tick; None for a skipped part without motion."""
        name, options = f"{recording.root.name}:{number}", self.options
        try:
            chosen = choose_key_frames(episode, recording.dataset.fps, options.key_frames)
        except DatasetError as error:
            if not options.skip_still:
                what = f"{name} cannot be converted."
                raise DatasetError(what, got=error, allowed="motion", hint="--skip-still") from error
            self.skipped.append(name)
            return None
        columns = demonstration_columns(
            episode, chosen, lambda tick: recording.pictures(number, begin + tick), calibration, options.rows
        )
        self.ticks += len(episode)
        self.key_frames += len(chosen.rows) - 1
        recorded = {
            "recording": recording.root.name,
            "episode": number,
            "robot_type": recording.dataset.info.get("robot_type"),
            "fps": recording.dataset.fps,
            "corrections": INTERVENTION in recording.dataset.features,
            "plugin": lerobot_adamanip.__version__,
            "ticks": (begin + chosen.rows).tolist(),
        }
        record = {
            "task": episode.task,
            "success": bool(columns[schema.SUCCESS].any()),
            "key_frames": len(chosen.rows) - 1,
            "camera": camera_record(calibration, options.rows.image_size),
            "recorded": recorded,
        }
        return RecordedEpisode(columns, record)


def _parts(episode: DenseEpisode) -> list[tuple[int, DenseEpisode]]:
    """Returns the demonstrated parts of an episode by first tick: the whole episode, or each human intervention."""
    if episode.corrected is None:
        return [(0, episode)]
    edges = np.flatnonzero(np.diff(np.r_[False, episode.corrected, False])).tolist()
    spans = zip(edges[::2], edges[1::2], strict=True)
    return [(begin, episode.take(slice(begin, end))) for begin, end in spans if end - begin >= _LEAST_TICKS]


def _assembled(root: Path, shards: list[Path], options: ConvertOptions, repo_id: str, progress: Progress) -> Path:
    """Writes a dataset of the shards, syncs it and verifies it."""
    if not shards:
        raise DatasetError(
            "No episode was converted.", got="0 episodes", allowed="1 or more", hint="adamanip check RECORDING"
        )
    first, size = read_record(shards[0]) or {}, options.rows.image_size
    dataset = create_dataset(
        root,
        repo_id,
        features=schema.dataset_features(
            options.rows.num_points,
            size or schema.IMAGE_SIZE,
            cameras=() if size is None else (FRONT_CAMERA,),
        ),
        intrinsics=first["camera"]["intrinsics"],
        workspace=None if options.rows.workspace == DEFAULT_WORKSPACE else options.rows.workspace,
        depth_camera=options.camera,
    )
    records, lengths = append_shards(dataset, shards, lambda done, total: progress("assemble", done, total))
    write_statistics(root, dataset.meta.features)
    columns = {name: [record[name] for record in records] for name in ("success", "key_frames")}
    columns |= {name: [to_json(record[name]) for record in records] for name in ("camera", "recorded")}
    add_episode_columns(root, columns)
    files.write_atomically(root / "meta" / "cameras.json", cameras_json([record["camera"] for record in records]))
    files.remove_tree(root / "images")
    files.sync_tree(root)
    read_back(root, lengths)
    return root
