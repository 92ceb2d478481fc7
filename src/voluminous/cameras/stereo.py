"""Stereo pictures: two eyes beside each other, or above each other, in one picture."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from ..backend import dr
from ..backend.types import Float
from ..errors import InputError, check_name
from ..units import as_given, plain, unit_of

T = TypeVar("T", int, float)

LAYOUTS = ("side-by-side", "over-under")
SEEN_TWICE = (
    "a stereo picture shows each point twice, so it has no objects such as stars or lines; leave "
    "out stereo, or the objects"
)


def check_stereo(stereo: str | None, eye_distance: object) -> None:
    """Check the arguments of a camera with two eyes."""
    if stereo is None:
        if eye_distance is not None:
            raise InputError(f"eye_distance needs stereo=, one of {', '.join(LAYOUTS)}")
        return
    check_name("stereo", stereo, LAYOUTS)
    if eye_distance is not None:
        given = as_given(eye_distance, "eye_distance")
        size = np.asarray(plain(given, unit_of(given), "eye_distance"))
        if size.shape != () or not np.isfinite(size) or size < 0:
            raise InputError(f"eye_distance must be a length, got {eye_distance!r}")


def doubled(size: tuple[T, T], stereo: str | None) -> tuple[T, T]:
    """Return the size of the picture, in pixels or on the plane, from the size for one eye."""
    across, along = size
    if stereo is None:
        return across, along
    return (2 * across, along) if stereo == "side-by-side" else (across, 2 * along)


def halved(size: tuple[T, T], stereo: str | None) -> tuple[T, T]:
    """Return the size for one eye from that of the picture: the inverse of `doubled`."""
    across, along = size
    kind = type(across)
    if stereo is None:
        return across, along
    both = (across / 2, along) if stereo == "side-by-side" else (across, along / 2)
    return kind(both[0]), kind(both[1])


def one_eye(stereo: str | None, u: Float, v: Float, half: Float) -> tuple[Float, Float, Float]:
    """Return a point of the picture as one eye sees it, and the eye: -1 left, 1 right, 0 neither.

    Parameters
    ----------
    u, v : array
        The point on the plane of the whole picture.
    half : array
        Half the width (side by side) or height (over-under) of the picture for one eye.
    """
    if stereo is None:
        return u, v, None
    if stereo == "side-by-side":
        right = u >= 0
        return dr.select(right, u - half, u + half), v, dr.select(right, type(u)(1), type(u)(-1))
    left = v >= 0  # above is the left eye's, as in spherical video
    return u, dr.select(left, v - half, v + half), dr.select(left, type(u)(-1), type(u)(1))
