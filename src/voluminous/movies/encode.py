"""Film files made of pictures: MP4 by PyAV (FFmpeg), GIF and WebP by Pillow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..packages import require


def encode(paths: list[Path], target: Path, suffix: str, fps: float, codec: str) -> None:
    """Write a film of pictures.

    Parameters
    ----------
    paths : list of Path
        PNG files, one per frame.
    target : Path
        Where to write.
    suffix : str
        One of `ENCODERS`.
    fps : float
        Frames per second.
    codec : str
        Of an MP4.
    """
    if not 0.1 <= fps <= 1000:
        raise InputError(f"fps must be between 0.1 and 1000, got {fps!r}")
    ENCODERS[suffix](_frames(paths), target, fps, codec)


def _frames(paths: list[Path]) -> Iterator[np.ndarray]:
    from PIL import Image as Pillow

    for path in paths:
        with Pillow.open(path) as file:
            yield np.asarray(file.convert("RGB"))


def _mp4(frames: Iterator[np.ndarray], target: Path, fps: float, codec: str) -> None:
    av = require("av", "movie", "writing an .mp4")
    with av.open(str(target), "w", format="mp4", options={"movflags": "faststart"}) as file:
        stream: Any = None
        for frame in frames:
            # Half of the colours' resolution: players show no other, and sides must be even.
            frame = np.pad(frame, [(0, n % 2) for n in frame.shape[:2]] + [(0, 0)], mode="edge")
            if stream is None:
                stream = _stream(av, file, codec, fps, frame.shape)
            for packet in stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")):
                file.mux(packet)
        for packet in stream.encode():
            file.mux(packet)


def _stream(av: Any, file: Any, codec: str, fps: float, shape: tuple[int, ...]) -> Any:
    try:
        stream = file.add_stream(codec, rate=Fraction(fps).limit_denominator(1001))
    except Exception as error:
        raise InputError(f"FFmpeg has no encoder {codec!r}; libx264 and libsvtav1 are") from error
    stream.height, stream.width = shape[:2]
    stream.pix_fmt = "yuv420p"
    stream.options = {"crf": "18"} if codec == "libx264" else {"crf": "24"}
    return stream


def _pillow(kind: str, **options: Any) -> Callable[..., None]:
    def write(frames: Iterator[np.ndarray], target: Path, fps: float, codec: str) -> None:
        from PIL import Image as Pillow

        pictures = (Pillow.fromarray(frame) for frame in frames)
        first = next(pictures)
        duration = 1000.0 / fps
        first.save(
            target,
            kind,
            save_all=True,
            append_images=pictures,
            duration=max(1, round(duration)),
            loop=0,
            **options,
        )

    return write


ENCODERS: dict[str, Callable[..., None]] = {
    ".mp4": _mp4,
    ".gif": _pillow("GIF"),
    ".webp": _pillow("WEBP", quality=90),
}
