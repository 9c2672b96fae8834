"""Computes the columns of a demonstration from the key frames of a dense episode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import PIXEL_CONVENTION
from lerobot_adamanip.contract.control import FINGER_TRAVEL
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE, Workspace
from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.hardware.camera_frames import CameraCalibration
from lerobot_adamanip.hardware.depth_cloud import depth_cloud
from lerobot_adamanip.hardware.features import UNLABELLED
from lerobot_adamanip.recordings.keyframe_choice import ChosenKeyFrames, DenseEpisode
from lerobot_adamanip.util.errors import DatasetError

Pictures = Callable[[int], tuple[NDArray[np.uint8] | None, NDArray[np.uint16]]]
"""Tick -> colour (H, W, 3), if any, and depth (H, W) [mm]."""


@dataclass(frozen=True)
class RowOptions:
    """Sizes of the columns.

    Attributes:
        num_points: number of points per cloud.
        image_size: height and width of the front image [px]; None for no image.
        workspace: bounding box of the clouds.
    """

    num_points: int = schema.DEFAULT_NUM_POINTS
    image_size: int | None = schema.IMAGE_SIZE
    workspace: Workspace = DEFAULT_WORKSPACE


def demonstration_columns(
    episode: DenseEpisode,
    chosen: ChosenKeyFrames,
    pictures: Pictures,
    calibration: CameraCalibration,
    options: RowOptions,
) -> dict[str, NDArray[Any]]:
    """Returns one array (K, ...) per dataset column for the K key frames of an episode.

    Tries are unlabelled: phase and trial are -1, and no row has a try. Object joints are unknown and set to 0.
    ``action`` is the corrector's action, if any; ``complementary_info.executed`` is the target that the arm accepted.

    Raises:
        DatasetError: images are requested but not recorded.
    """
    rows, count = chosen.rows, len(chosen.rows)
    # Done by the end of the row's action, at the next row's reading; the last row's lasts to the end of the episode.
    success = np.maximum.accumulate(episode.success)[np.r_[rows[1:], len(episode) - 1]]
    labels: dict[str, NDArray[Any]] = {
        schema.PHASE: np.full(count, UNLABELLED),
        schema.TRIAL: np.full(count, UNLABELLED),
        schema.OUTCOME: chosen.outcomes,
        schema.TRIED: np.full(count, -1),
        schema.FAILED: np.zeros(count, bool),
        schema.PROGRESS: np.zeros(count),
        schema.SUCCESS: success,
        schema.DONE: np.arange(count) == count - 1,
    }
    state = episode.state[rows]
    return {
        **_seen(episode.pose[rows], rows, pictures, calibration, options),
        schema.STATE: state,
        schema.EFFORT: episode.effort[rows],
        schema.ACTION: _asked(episode, chosen),
        **{key: values[:, None].astype(schema.LABEL_DTYPES[key]) for key, values in labels.items()},
        schema.EXECUTED: chosen.actions,
        schema.JOINTS: _joints(state),
    }


def _asked(episode: DenseEpisode, chosen: ChosenKeyFrames) -> NDArray[np.float32]:
    if episode.corrected is None:
        return chosen.actions
    # the next row records the action of a row, after the safety filter, as sent
    asked = episode.asked[np.maximum(chosen.accepted - 1, 0)].copy()
    asked[:, schema.GRIPPER_DIM] = asked[:, schema.GRIPPER_DIM] > 0.5
    return np.asarray(np.concatenate([asked, chosen.actions[-1:]]), np.float32)


def _seen(
    poses: NDArray[np.float64],
    rows: NDArray[np.int64],
    pictures: Pictures,
    calibration: CameraCalibration,
    options: RowOptions,
) -> dict[str, NDArray[Any]]:
    clouds, images = [], []
    for pose, row in zip(poses, rows.tolist(), strict=True):
        colour, depth = pictures(row)
        tcp_in_base = pose_from_vector(pose)[0]
        clouds.append(depth_cloud(depth, calibration, options.num_points, options.workspace, tcp_in_base))
        if options.image_size is None:
            continue
        if colour is None:
            raise DatasetError(
                "The recording has no pictures.", got="only depth", allowed="colour and depth", hint="--no-images"
            )
        images.append(square_image(colour, options.image_size))
    columns: dict[str, NDArray[Any]] = {schema.POINT_CLOUD: np.stack(clouds).reshape(len(clouds), -1)}
    return columns | ({schema.FRONT_IMAGE: np.stack(images)} if images else {})


def square_image(picture: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """Returns the centre square of an image (H, W, 3), resized to (size, size, 3)."""
    height, width = picture.shape[:2]
    side = min(height, width)
    left, top = (width - side) // 2, (height - side) // 2
    image = Image.fromarray(picture[top : top + side, left : left + side])
    how = Image.Resampling.BOX if side > size else Image.Resampling.BILINEAR
    return np.asarray(image if side == size else image.resize((size, size), how))


def camera_record(calibration: CameraCalibration, size: int | None) -> dict[str, Any]:
    """Returns the JSON-able value of the column ``camera``, in the simulator's format.

    Args:
        calibration: camera calibration. Describes the colour imager if calibrated, else the depth imager.
        size: size of the front image [px]; None without images, for the centre square of the depth image.
    """
    imager = calibration.color or calibration.depth
    side = min(imager.width, imager.height)
    matrix = imager.matrix.copy()
    matrix[:2, 2] -= ((imager.width - side) // 2, (imager.height - side) // 2)
    pixels = size or side
    scale = pixels / side
    matrix[:2, 2] += 0.5  # from the corner, where scaling has its fixed point
    matrix = np.diag([scale, scale, 1.0]) @ matrix
    matrix[:2, 2] -= 0.5
    pose = calibration.depth_pose
    if calibration.color is not None and calibration.depth_in_color is not None:
        pose = pose @ np.linalg.inv(calibration.depth_in_color)
    record = {"intrinsics": matrix.tolist(), "extrinsics": pose.tolist(), "width": pixels, "height": pixels}
    record["convention"] = PIXEL_CONVENTION
    return {**record, "frame": "tcp"} if calibration.depth_in_base is None else record


def _joints(state: NDArray[np.float32]) -> NDArray[np.float32]:
    finger = FINGER_TRAVEL * state[:, schema.GRIPPER_DIM : schema.GRIPPER_DIM + 1]
    arm = state[:, schema.ACTION_DIM : schema.ACTION_DIM + schema.NUM_JOINTS]
    unknown = np.zeros((len(state), schema.MAX_OBJECT_JOINTS))
    return np.asarray(np.concatenate([arm, finger, finger, unknown], axis=1), np.float32)
