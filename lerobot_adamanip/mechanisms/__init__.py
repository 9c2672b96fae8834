"""Hidden state as pure batched functions: five families, and the mechanisms that combine them."""

from lerobot_adamanip.mechanisms.base import Command, JointLimits, Mechanism, Overrides, Reading, replace_rows
from lerobot_adamanip.mechanisms.lock import Lock, LockState
from lerobot_adamanip.mechanisms.push_rotate import PushOrRotate, PushRotateState
from lerobot_adamanip.mechanisms.rotate_slide import RotateSlideState, RotateThenSlide
from lerobot_adamanip.mechanisms.rotation_direction import RandomRotationDirection, RotationState
from lerobot_adamanip.mechanisms.safe import SafeMechanism, SafeMechanismConfig, SafeState
from lerobot_adamanip.mechanisms.switch_contact import SwitchContact

__all__ = [
    "Command", "JointLimits", "Lock", "LockState", "Mechanism", "Overrides", "PushOrRotate", "PushRotateState",
    "RandomRotationDirection", "Reading", "RotateSlideState", "RotateThenSlide", "RotationState", "SafeMechanism",
    "SafeMechanismConfig", "SafeState", "SwitchContact", "replace_rows",
]  # fmt: skip
