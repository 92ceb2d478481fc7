"""Film files made of pictures: MP4 by PyAV (FFmpeg), GIF and WebP by Pillow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..packages import require

# Films of so many lines have the colours of high definition.
_LINES_OF_709 = 720
# Frames per second: shorter ones of a GIF are shown for 100 ms by most players.
_MOST, _MOST_OF_GIF = 1000, 50


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
    ENCODERS[suffix](paths, target, fps, codec)


def check_fps(fps: Any, suffix: str) -> None:
    """Refuse a number of frames per second that a film cannot have."""
    most, real = _MOST_OF_GIF if suffix == ".gif" else _MOST, isinstance(fps, Real)
    if not real or not 0.1 <= fps <= most:
        raise InputError(f"fps must be between 0.1 and {most} in a {suffix}, got {fps!r}")


def _frames(paths: list[Path]) -> Iterator[np.ndarray]:
    from PIL import Image as Pillow

    for path in paths:
        with Pillow.open(path) as file:
            yield np.asarray(file.convert("RGB"))


def _mp4(paths: list[Path], target: Path, fps: float, codec: str) -> None:
    av = require("av", "movie", "writing an .mp4")
    with av.open(str(target), "w", format="mp4", options={"movflags": "faststart"}) as file:
        stream: Any = None
        for frame in _frames(paths):
            # Half of the colours' resolution: players show no other, and sides must be even.
            frame = np.pad(frame, [(0, n % 2) for n in frame.shape[:2]] + [(0, 0)], mode="edge")
            if stream is None:
                stream = _stream(av, file, codec, fps, frame.shape)
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24")
            picture = picture.reformat(format="yuv420p", dst_colorspace=_colors(len(frame))[0])
            for packet in stream.encode(picture):
                file.mux(packet)
        for packet in stream.encode():
            file.mux(packet)


def _stream(av: Any, file: Any, codec: str, fps: float, shape: tuple[int, ...]) -> Any:
    try:
        stream = file.add_stream(codec, rate=Fraction(float(fps)).limit_denominator(1001))
    except Exception as error:
        raise InputError(f"FFmpeg has no encoder {codec!r}; libx264 and libsvtav1 are") from error
    stream.height, stream.width = shape[:2]
    stream.pix_fmt = "yuv420p"
    matrix, primaries, transfer = _colors(shape[0])[1]
    context = stream.codec_context
    context.colorspace, context.color_primaries, context.color_trc = matrix, primaries, transfer
    context.color_range = 1  # from 16 to 235
    stream.options = {"crf": "18"} if codec == "libx264" else {"crf": "24"}
    return stream


def _colors(lines: int) -> tuple[str, tuple[int, int, int]]:
    """Return how colours are written, for FFmpeg, and the numbers that tell so: ITU-T H.273.

    Players that read no tags take small films for BT.601 and large ones for BT.709.
    """
    return ("ITU709", (1, 1, 1)) if lines >= _LINES_OF_709 else ("ITU601", (6, 6, 6))


def _pillow(kind: str, tick: int, **options: Any) -> Callable[..., None]:
    def write(paths: list[Path], target: Path, fps: float, codec: str) -> None:
        from PIL import Image as Pillow

        # Each frame begins when it should, to rounding: the film does not drift.
        begins = [tick * round(1000.0 * k / (tick * fps)) for k in range(len(paths))]
        begins.append(begins[-1] + tick * max(1, round(1000.0 / (tick * fps))))
        pictures = (Pillow.fromarray(frame) for frame in _frames(paths))
        first = next(pictures)
        first.save(
            target,
            kind,
            save_all=True,
            append_images=pictures,
            duration=np.diff(begins).tolist(),
            loop=0,
            **options,
        )

    return write


ENCODERS: dict[str, Callable[..., None]] = {
    ".mp4": _mp4,
    ".gif": _pillow("GIF", 10),
    ".webp": _pillow("WEBP", 1, quality=90),
}
