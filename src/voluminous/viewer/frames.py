"""Pictures as bytes: small ones of 8 bits for a hand that moves, exact ones for an eye that rests.

Both hold intensities, not colours: exposure, stretch and colour map are the page's and cost no
bytes. See ``frontend/PROTOCOL.md``.
"""

from __future__ import annotations

import io
import json
import struct
import zlib
from typing import Any

import numpy as np

MAGIC = b"VLM1"
# Quality of a preview: 35 KiB and 0.9 ms for 400 × 400 × 3, off by 1.7 % in the middle of all
# pixels; colours are not subsampled.
_QUALITY = 92
# Ratio of the brightest to the faintest intensity of a preview: 16 factors of two.
_STOPS = 16.0


def packed(message: dict[str, Any], payload: bytes = b"") -> bytes:
    """Return a message and its bytes as one block, for a websocket."""
    head = json.dumps(message, separators=(",", ":"), allow_nan=False).encode()
    return b"".join([MAGIC, struct.pack("<I", len(head)), head, payload])


def unpacked(block: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the message and the bytes of a block: the inverse of `packed`."""
    if block[:4] != MAGIC:
        raise ValueError("not a block of this protocol")
    (length,) = struct.unpack_from("<I", block, 4)
    message: dict[str, Any] = json.loads(block[8 : 8 + length])
    return message, block[8 + length :]


def log_jpeg(intensity: np.ndarray) -> tuple[dict[str, Any], bytes]:
    """Return a preview: the logarithm of each channel in 8 bits, as a JPEG.

    Parameters
    ----------
    intensity : array, shape (ny, nx, channel)
        Row 0 at the bottom; NaN, negative and zero values become zero.
    """
    from PIL import Image

    ny, nx, channels = intensity.shape
    values = np.nan_to_num(intensity, nan=0.0, posinf=np.finfo(np.float32).max)
    top = float(values.max(initial=0.0))
    high = float(np.log2(top)) if top > 0.0 else 0.0
    low = high - _STOPS
    with np.errstate(divide="ignore", invalid="ignore"):
        levels = 1.5 + (np.log2(values) - low) * (254.0 / _STOPS)
    # What is fainter than the range is black.
    codes = np.where(levels >= 1.0, np.minimum(levels, 255.0), 0.0).astype(np.uint8)[::-1]
    if channels == 3:
        picture = Image.fromarray(np.ascontiguousarray(codes))
    else:
        rows = np.moveaxis(codes, 2, 0).reshape(channels * ny, nx)
        picture = Image.fromarray(np.ascontiguousarray(rows))
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=_QUALITY, subsampling=0)
    head = {"codec": "log-jpeg", "width": nx, "height": ny, "channels": channels}
    return {**head, "low": low, "high": high}, file.getvalue()


def linear_jpeg(
    intensity: np.ndarray, window: tuple[float, float] | None
) -> tuple[dict[str, Any], bytes]:
    """Return a preview of a projection: 8 bits for values of either sign, as a JPEG.

    Parameters
    ----------
    intensity : array, shape (ny, nx, 1)
        Row 0 at the bottom; NaN becomes code 0.
    window : (float, float), optional
        What is shown: three times as much is coded, so that another window is seen at once.
    """
    from PIL import Image

    values = intensity[::-1, :, 0].astype(np.float64)
    valid = values[np.isfinite(values)]
    least, most = (valid.min(), valid.max()) if valid.size else (0.0, 1.0)
    positive = valid[valid > 0.0]
    low, high = float(least), float(most)
    if window is not None:
        reach = abs(window[1] - window[0])
        low, high = max(low, min(window) - reach), min(high, max(window) + reach)
    if not low < high:
        low, high = float(least), float(max(most, np.nextafter(np.float32(least), np.inf)))
    levels = 1.5 + (np.clip(values, low, high) - low) * (254.0 / (high - low))
    codes = np.where(np.isnan(values), 0.0, np.minimum(levels, 255.0)).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(codes).save(file, "JPEG", quality=_QUALITY)
    head = {"codec": "linear-jpeg", "width": values.shape[1], "height": values.shape[0]}
    limits = [[float(least), float(positive.min(initial=most)), float(most)]]
    return {**head, "channels": 1, "low": low, "high": high, "limits": limits}, file.getvalue()


def from_log_jpeg(head: dict[str, Any], payload: bytes) -> np.ndarray:
    """Return the intensities of a preview, row 0 at the bottom."""
    from PIL import Image

    nx, ny, channels = head["width"], head["height"], head["channels"]
    codes = np.asarray(Image.open(io.BytesIO(payload)))
    if channels != 3:
        codes = np.moveaxis(codes.reshape(channels, ny, nx), 0, 2)
    values = np.exp2(head["low"] + (head["high"] - head["low"]) * (codes - 1.0) / 254.0)
    return np.where(codes > 0, values, 0.0)[::-1]


def float16(intensity: np.ndarray, missing: float = 0.0) -> tuple[dict[str, Any], bytes]:
    """Return an exact frame: numbers of 11 binary digits, whatever their range.

    Differences between neighbours, and the two bytes of each number apart, compress to half.
    """
    ny, nx, channels = intensity.shape
    values = np.nan_to_num(
        intensity, nan=missing, posinf=np.finfo(np.float32).max, neginf=-np.finfo(np.float32).max
    )
    top = float(np.abs(values).max(initial=0.0, where=np.isfinite(values)))
    # The brightest is 2^15, so that the faintest of 2^-24 of it and more are normal numbers.
    low = int(np.ceil(np.log2(top))) - 15 if top > 0.0 else 0
    with np.errstate(over="ignore"):
        halves = np.ldexp(values, -low).astype("<f2")
    planes = np.moveaxis(halves[::-1], 2, 0).reshape(-1, nx)
    codes = np.ascontiguousarray(planes).view(np.uint16)
    codes[:, 1:] = codes[:, 1:] - codes[:, :-1]
    apart = codes.view(np.uint8).reshape(-1, 2).T
    head = {"codec": "float16", "width": nx, "height": ny, "channels": channels}
    return {**head, "low": low, "high": low + 15}, zlib.compress(apart.tobytes(), 1)


def from_float16(head: dict[str, Any], payload: bytes) -> np.ndarray:
    """Return the intensities of an exact frame, row 0 at the bottom."""
    nx, ny, channels = head["width"], head["height"], head["channels"]
    apart = np.frombuffer(zlib.decompress(payload), np.uint8).reshape(2, -1)
    codes = np.ascontiguousarray(apart.T).view("<u2").reshape(-1, nx)
    codes = np.cumsum(codes, axis=1, dtype=np.uint16)
    planes = codes.view("<f2").astype(np.float64).reshape(channels, ny, nx)
    intensity: np.ndarray = np.moveaxis(np.ldexp(planes, head["low"]), 0, 2)[::-1]
    return intensity
