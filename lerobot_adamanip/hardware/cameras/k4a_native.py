"""The Azure Kinect's C library (libk4a 1.4), as far as a camera needs it.

The wheel `pyk4a-bundle` holds the library with its closed depth engine, and a Python module that is compiled for
NumPy 1 and cannot be imported beside NumPy 2. So its libraries are loaded, and its module is not. Structures are those
of the SDK's ``k4atypes.h``.
"""

from __future__ import annotations

import ctypes
import functools
from ctypes import POINTER, Structure, byref, c_bool, c_char_p, c_float, c_int, c_int32, c_uint32, c_uint64, c_void_p
from importlib.metadata import PackageNotFoundError, files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.util.errors import RobotError

WHEEL = "pyk4a-bundle"
BGRA32, DEPTH, COLOR = 3, 0, 1
"""An image format, and two of the four imagers of a calibration."""
SUCCEEDED, TIMED_OUT = 0, 2


class Configuration(Structure):
    """``k4a_device_configuration_t``."""

    _fields_ = (
        ("color_format", c_int), ("color_resolution", c_int), ("depth_mode", c_int), ("camera_fps", c_int),
        ("synchronized_images_only", c_bool), ("depth_delay_off_color_usec", c_int32), ("wired_sync_mode", c_int),
        ("subordinate_delay_off_master_usec", c_uint32), ("disable_streaming_indicator", c_bool),
    )  # fmt: skip


class Extrinsics(Structure):
    """``k4a_calibration_extrinsics_t``: rotation by rows, translation in millimetres."""

    _fields_ = (("rotation", c_float * 9), ("translation", c_float * 3))


class Parameters(Structure):
    """``k4a_calibration_intrinsic_parameters_t``."""

    _fields_ = (
        ("cx", c_float), ("cy", c_float), ("fx", c_float), ("fy", c_float), ("k1", c_float), ("k2", c_float),
        ("k3", c_float), ("k4", c_float), ("k5", c_float), ("k6", c_float), ("codx", c_float), ("cody", c_float),
        ("p2", c_float), ("p1", c_float), ("metric_radius", c_float),
    )  # fmt: skip


class Imager(Structure):
    """``k4a_calibration_camera_t``, its intrinsics spread out."""

    _fields_ = (
        ("extrinsics", Extrinsics), ("type", c_int), ("parameter_count", c_uint32), ("parameters", Parameters),
        ("resolution_width", c_int), ("resolution_height", c_int), ("metric_radius", c_float),
    )  # fmt: skip


class Calibration(Structure):
    """``k4a_calibration_t``."""

    _fields_ = (
        ("depth", Imager), ("color", Imager), ("extrinsics", (Extrinsics * 4) * 4), ("depth_mode", c_int),
        ("color_resolution", c_int),
    )  # fmt: skip


_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "k4a_device_get_installed_count": (c_uint32, ()),
    "k4a_device_open": (c_int, (c_uint32, POINTER(c_void_p))),
    "k4a_device_close": (None, (c_void_p,)),
    "k4a_device_get_serialnum": (c_int, (c_void_p, c_char_p, POINTER(ctypes.c_size_t))),
    "k4a_device_start_cameras": (c_int, (c_void_p, POINTER(Configuration))),
    "k4a_device_stop_cameras": (None, (c_void_p,)),
    "k4a_device_get_calibration": (c_int, (c_void_p, c_int, c_int, POINTER(Calibration))),
    "k4a_calibration_get_from_raw": (c_int, (c_char_p, ctypes.c_size_t, c_int, c_int, POINTER(Calibration))),
    "k4a_device_get_capture": (c_int, (c_void_p, POINTER(c_void_p), c_int32)),
    "k4a_capture_release": (None, (c_void_p,)),
    "k4a_capture_get_color_image": (c_void_p, (c_void_p,)),
    "k4a_capture_get_depth_image": (c_void_p, (c_void_p,)),
    "k4a_image_get_buffer": (c_void_p, (c_void_p,)),
    "k4a_image_get_width_pixels": (c_int, (c_void_p,)),
    "k4a_image_get_height_pixels": (c_int, (c_void_p,)),
    "k4a_image_get_stride_bytes": (c_int, (c_void_p,)),
    "k4a_image_get_device_timestamp_usec": (c_uint64, (c_void_p,)),
    "k4a_image_release": (None, (c_void_p,)),
}


@functools.cache
def library() -> Any:
    """Returns libk4a, with the types of what is called of it; raises `RobotError` where the wheel is not installed."""
    try:
        found = {file.name.partition(".")[0].partition("-")[0]: file for file in files(WHEEL) or ()}
        # The depth engine first: libk4a looks for it by name, and finds what is loaded.
        loaded = [
            ctypes.CDLL(str(found[name].locate()), mode=ctypes.RTLD_GLOBAL) for name in ("libdepthengine", "libk4a")
        ]
    except (PackageNotFoundError, KeyError, OSError) as error:
        raise RobotError(
            "The library of the Azure Kinect cannot be loaded.",
            got=error,
            allowed=f"the wheel {WHEEL}, on Linux",
            hint="pip install 'lerobot_env_adamanip[k4a]'",
        ) from error
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(loaded[1], name)
        function.restype, function.argtypes = result, arguments
    return loaded[1]


def serial_number(sdk: Any, device: Any) -> str:
    """Returns that of an open device; empty where it does not tell."""
    size = ctypes.c_size_t(64)
    text = ctypes.create_string_buffer(64)
    done = sdk.k4a_device_get_serialnum(device, text, byref(size))
    return text.value.decode(errors="replace") if done == SUCCEEDED else ""


def picture(sdk: Any, image: Any, dtype: Any, channels: int) -> NDArray[Any]:
    """Returns a copy of an image, (H, W, channels), or (H, W) of one channel; rows may be padded."""
    height, width = sdk.k4a_image_get_height_pixels(image), sdk.k4a_image_get_width_pixels(image)
    stride = sdk.k4a_image_get_stride_bytes(image)
    content = ctypes.string_at(sdk.k4a_image_get_buffer(image), height * stride)
    rows = np.frombuffer(content, np.uint8).reshape(height, stride)[:, : width * channels * np.dtype(dtype).itemsize]
    pixels: NDArray[Any] = np.ascontiguousarray(rows).view(dtype).reshape(height, width, channels)
    return np.asarray(pixels[..., 0] if channels == 1 else pixels)
