"""Cut an episode out of a video file by copying packets; LeRobot starts each episode with a key frame."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot_adamanip.datasets.encoding import ENCODER_THREADS, encoder_like
from lerobot_adamanip.datasets.opening import VIDEO_PATH, as_typed, damaged, first_line
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.video import open_mp4


def cut_episode(root: Path, key: str, feature: Mapping[str, Any], row: Mapping[str, Any], fps: int) -> bytes:
    """Returns a video file with one episode's frames; ``feature`` describes the column, ``row`` the episode.

    Packets are copied without loss. Frames are re-encoded with the settings of ``feature``, see
    `encoding.encoder_like`, if its codec is another one, or if the episode does not start with a key frame, as after
    LeRobot's own cutting.

    Raises:
        DatasetError: the video is damaged or too short, or would be re-encoded and is depth or of an unknown codec.
    """
    import av

    chunk, file, begin, end = (
        row[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index", "from_timestamp", "to_timestamp")
    )
    path = root / VIDEO_PATH.format(video_key=key, chunk_index=chunk, file_index=file)
    span = (round(begin * fps), round(end * fps))
    with tempfile.TemporaryDirectory(prefix="adamanip-") as scratch:
        cut = Path(scratch) / "episode.mp4"
        try:
            frames = _copied(path, cut, span, fps, (feature.get("info") or {}).get("video.codec"))
            if frames is None:
                frames = _encoded_anew(path, cut, span, fps, feature)
        except (av.FFmpegError, IndexError) as error:
            raise damaged(root, f"{path.relative_to(root)}: {first_line(error)}") from error
        if frames != row["length"]:
            raise DatasetError(
                "A video does not fit its episode.",
                got=f"episode {row['episode_index']}: {frames} frames from {span[0]} on in {path}",
                allowed=f"{row['length']} frames, as many as rows",
                hint=f"adamanip check {as_typed(root)}",
            )
        return cut.read_bytes()


def _copied(path: Path, out: Path, span: tuple[int, int], fps: int, codec: str | None = None) -> int | None:
    """Copies the packets of a span of frames.

    Returns their number, or None if the first is not a key frame, or the video has another codec.
    """
    import av

    first, end = span
    with open_mp4(path) as source, av.open(str(out), "w", options={"movflags": "faststart"}) as target:
        stream: Any = source.streams.video[0]
        if codec not in (None, stream.codec_context.codec.canonical_name):
            return None
        copy = target.add_stream_from_template(stream, opaque=True)  # its decoder may have no encoder of that name
        copy.time_base = stream.time_base
        source.seek(round(first / fps / stream.time_base), stream=stream, backward=True)
        packet: Any
        begin, frames = 0, 0
        for packet in source.demux(stream):
            number = None if packet.pts is None else round(float(packet.pts * stream.time_base) * fps)
            if number is None or number < first:
                continue
            if frames == 0:
                if not packet.is_keyframe or number != first:
                    return None
                begin = packet.pts
            if number >= end:
                if packet.is_keyframe:
                    break
                continue
            packet.pts, packet.dts = packet.pts - begin, packet.dts - begin
            packet.stream = copy
            target.mux(packet)
            frames += 1
    return frames


def _encoded_anew(path: Path, out: Path, span: tuple[int, int], fps: int, feature: Mapping[str, Any]) -> int:
    from lerobot.datasets.video_utils import encode_video_frames

    if (feature.get("info") or {}).get("is_depth_map"):
        raise DatasetError(
            "Depth cannot be re-encoded without loss.",
            got=f"an episode that starts between key frames, at frame {span[0]} of {path}",
            allowed="videos in which each episode starts with a key frame, as `lerobot-record` writes them",
            hint="the recording as it was before editing",
        )
    folder = out.with_suffix("")
    folder.mkdir()
    frame: Any
    with open_mp4(path) as container:
        for number, frame in enumerate(itertools.islice(container.decode(video=0), *span)):
            frame.to_image().save(folder / f"frame-{number:06d}.png")
    if count := len(list(folder.iterdir())):
        encoder = encoder_like(feature.get("info") or {})
        encode_video_frames(folder, out, fps, video_encoder=encoder, encoder_threads=ENCODER_THREADS, overwrite=True)
    return count
