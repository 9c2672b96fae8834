"""Values that the recorder adds to the rows of a recording: labels, and the arm's reading."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import FINGER_TRAVEL, FULL
from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.hardware.arm import ArmReading
from lerobot_adamanip.hardware.camera_frames import CameraCalibration
from lerobot_adamanip.hardware.dense_kinds import encode_action, state_of
from lerobot_adamanip.hardware.features import ARM, CAMERA_NAMES, UNLABELLED
from lerobot_adamanip.hardware.target_geometry import Target

Row = dict[str, NDArray[np.generic]]
NO_OUTCOME = -1.0
MAX_ROWS = 4096
"""Number of observations whose rows are kept. A rollout may store an observation seconds later."""


def recorded_row(
    action: str, reading: ArmReading, sent: Target, stamp: float, camera: CameraCalibration | None = None
) -> Row:
    """Returns the added columns of one row, before its action.

    Nobody labels the tries of a person: their codes are `UNLABELLED` or 0. The object's joints are unknown and 0.

    Args:
        action: kind of action, see `contract.control`.
        reading: arm reading of the observation.
        sent: (10,) last accepted target.
        stamp: measurement time since connection [s].
        camera: calibration of the front camera at this moment.
    """
    outcome = NO_OUTCOME if reading.outcome is None else float(reading.outcome)
    seen_from = np.zeros(len(CAMERA_NAMES)) if camera is None else pose_vector(camera.depth_pose, 0.0)[:-1]
    arm = (state_of(FULL, reading), reading.effort, sent, (outcome, stamp), seen_from)
    joints = (reading.qpos, np.full(2, FINGER_TRAVEL * reading.gripper), np.zeros(schema.MAX_OBJECT_JOINTS))
    codes = {schema.PHASE: UNLABELLED, schema.TRIAL: UNLABELLED, schema.TRIED: -1, schema.OUTCOME: schema.GOES_ON}
    labels = {key: np.array([codes.get(key, 0)], dtype) for key, dtype in schema.LABEL_DTYPES.items()}
    return {
        **labels,
        schema.DIRECTION: np.zeros(1, np.int64),
        schema.EXECUTED: np.array(list(encode_action(action, sent, reading).values()), np.float32),
        schema.KEY_FRAME: np.asarray(sent, np.float32),
        schema.JOINTS: np.concatenate(joints).astype(np.float32),
        ARM: np.concatenate([np.asarray(part, np.float64) for part in arm]).astype(np.float32),
    }


class ObservedRows:
    """Rows of the latest observations. LeRobot gives the recorder an observation's state only, which is the key.

    The latest of equal states counts: many observations are never recorded, so an earlier row may belong to none.
    """

    def __init__(self) -> None:
        self._rows: dict[bytes, Row] = {}

    def add(self, state: NDArray[np.float32], row: Row) -> None:
        """Stores the row of an observation."""
        self._rows.pop(key := state.tobytes(), None)
        self._rows[key] = row
        if len(self._rows) > MAX_ROWS:
            del self._rows[next(iter(self._rows))]

    def complete(self, executed: NDArray[np.float32], sent: Target, success: bool) -> None:
        """Adds to the latest row the action that was executed after it, and whether the task is done now."""
        if self._rows:
            row = self._rows[next(reversed(self._rows))]
            row |= {schema.EXECUTED: executed, schema.KEY_FRAME: sent, schema.SUCCESS: np.array([success])}

    def find(self, state: NDArray[np.generic]) -> Row:
        """Returns the row of an observed state; empty if it is unknown."""
        return self._rows.get(np.asarray(state, np.float32).tobytes(), {})
