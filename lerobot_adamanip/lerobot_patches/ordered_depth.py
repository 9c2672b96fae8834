"""Patch: write depth videos of our robots without B-frames.

Changes:
    `lerobot.datasets.lerobot_dataset.DatasetWriter`, for datasets of our robots (`is_dense`). x265 gets ``bframes=0``
    for depth, which stays lossless.
Why:
    With B-frames, one in four videos of one or two frames cannot be written ("pts/dts pair unsupported"). If an
    operator ends an episode at once, this error ends the session.
Without it:
    A recording session with depth may end with an error at an episode of one or two frames. The same by hand:
    ``--dataset.depth_encoder.extra_options='{"x265-params": "lossless=1:bframes=0"}'``.
Upstream:
    https://github.com/Multicorewareinc/x265/issues/934; for LeRobot none filed.
Needed for:
    0.6.1 and main of 2026-08-23, tested with both.
Guard:
    The writer and its streaming encoder keep a depth encoder as ``_depth_encoder``.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from lerobot.configs.video import DepthEncoderConfig
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.dataset_writer import DatasetWriter
from lerobot.datasets.video_utils import StreamingVideoEncoder

from lerobot_adamanip.hardware.features import is_dense
from lerobot_adamanip.lerobot_patches.support import UnsupportedError, replace

_X265 = "x265-params"
_ENCODER = "_depth_encoder"


def apply() -> None:
    """Applies the patch. Raises `UnsupportedError` if the encoder is kept elsewhere."""
    for holder in (DatasetWriter, StreamingVideoEncoder):
        if _ENCODER not in holder.__init__.__code__.co_names:
            raise UnsupportedError(f"{holder.__name__} has no {_ENCODER}")
    stock = lerobot_dataset.DatasetWriter

    def make_writer(meta: Any, *args: Any, **options: Any) -> Any:
        writer = stock(meta, *args, **options)
        for holder in (writer, options.get("streaming_encoder")):
            if holder is not None and is_dense(meta.features):
                setattr(holder, _ENCODER, in_order(getattr(holder, _ENCODER)))
        return writer

    replace(lerobot_dataset, "DatasetWriter", make_writer)


def in_order(encoder: DepthEncoderConfig) -> DepthEncoderConfig:
    """Returns a depth encoder without B-frames. Other codecs, or an encoder with B-frames set, stay unchanged."""
    parameters = str(encoder.extra_options.get(_X265, ""))
    if encoder.vcodec not in ("hevc", "libx265") or "bframes" in parameters:
        return encoder
    options = {**encoder.extra_options, _X265: ":".join(filter(None, (parameters, "bframes=0")))}
    return dataclasses.replace(encoder, extra_options=options)
