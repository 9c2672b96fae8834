"""Names of what the robot tells LeRobot, and what a dense recording of it therefore holds.

LeRobot's recorder puts all scalars of a robot into one ``observation.state``, in this order. Roll-outs keep only those
that end in ``.pos`` or ``.vel``, which are the contract's state: nothing else may end so.
"""

from __future__ import annotations

from lerobot_adamanip.schema import EFFORT_NAMES, POSE_NAMES, STATE_NAMES

SENT_NAMES = tuple(f"sent.{name.removesuffix('.pos')}" for name in POSE_NAMES)
"""The last target that the arm accepted: LeRobot stores the teleoperator's action, which may have been clipped."""
OUTCOME_NAME = "arm.outcome"
"""`lerobot_adamanip.keyframes.Outcome` of the latest key frame; -1 for none, and while the arm is streamed to."""
STAMP_NAME = "arm.stamp"
"""When the state was measured [s since the robot connected]: rows of LeRobot carry the loop's nominal time only."""
LABEL_NAME = "label.success"
"""1 once the operator has pressed the key for success, or the twin's task is done; 0 before."""
SCALAR_NAMES = (*STATE_NAMES, *EFFORT_NAMES, *SENT_NAMES, OUTCOME_NAME, STAMP_NAME, LABEL_NAME)
FRONT_CAMERA = "front"
"""Key of the camera whose depth becomes the cloud."""
DEPTH_SUFFIX = "_depth"
"""A camera's depth is a second image under its key and this: uint16, millimetres, 0 where nothing was seen."""
