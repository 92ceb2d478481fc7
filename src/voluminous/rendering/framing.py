"""A frame around what there is to see: data often fill a small part of their box."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..cameras import Orthographic
from ..cameras.views import view_angles
from ..errors import InputError
from ..first_view import FIRST_INCL, FIRST_PHI
from .prepare import prepare

if TYPE_CHECKING:
    from ..media import Medium
    from ..volume import Volume

# A picture of so many pixels tells where something is …
_COARSE = 96
# … brighter than this part of the brightest, but for this part of all its light (faint wisps).
_FAINT, _WISPS = 0.02, 2e-3
# What shows fills this part of the frame; one that is as full already is left alone.
_FILLED, _FULL = 0.85, 0.7


def framed(
    volume: Volume,
    medium: Medium | None = None,
    incl: Any = None,
    phi: Any = None,
    *,
    view: str | None = None,
    resolution: Any = 400,
) -> Orthographic:
    """Return a camera that sees all that a medium shows, and little around it.

    A coarse picture tells where that is: pixels of more than 2 % of its brightest, but for 0.2 % of
    their light along each axis. They fill 0.85 of the frame. Where they fill 0.7 of a square frame
    around the whole volume, all of that is seen.

    Parameters
    ----------
    volume : Volume
        Grid and fields.
    medium : Medium, optional
        What is to be seen of them. Without one the frame is around the whole volume: for
        projections and columns.
    incl, phi, resolution
        As for `Orthographic`; for angles that are not given see `view`.
    view : {"anterior", "posterior", "left", "right", "superior", "inferior", "stack"}, optional
        In place of angles. A patient from the front, the back, his left, his right, above and
        below, upright (from above and below with the front at the top), as
        ``volume.meta["orientation"]`` tells; pictures above each other as ImageJ shows them, where
        there is ``volume.meta["y_down"]``. By default ``"anterior"`` or ``"stack"`` where the
        volume tells so, else obliquely from above.

    Returns
    -------
    Orthographic
        Its ``width`` and ``shift`` are plain numbers in the volume's unit of length.

    Raises
    ------
    InputError, UnknownNameError
        As `render`; and if the volume does not tell how it lies, or angles are given besides.

    Examples
    --------
    >>> import numpy as np
    >>> import voluminous as vm
    >>> density = np.zeros((16, 16, 16))
    >>> density[4:6, 8:10, 8:10] = 1
    >>> volume = vm.Volume(vm.CartesianGrid.uniform(16, (0, 16)), density=density)
    >>> vm.framed(volume, vm.Coefficients("density", "density"), 90, 0).width < 6
    True
    """
    camera = first_camera(volume, incl, phi, view=view).replace(resolution=resolution)
    if medium is None:
        return camera
    job, _ = prepare(volume, medium, camera.replace(resolution=_COARSE), tolerance=None)
    light = job.run(0.0).emission.sum(axis=-1, dtype=np.float64)
    if not light.max() > 0.0:
        return camera
    limits = _limits(light, job.frame)
    size = [b - a + step for (a, b), step in zip(limits, job.frame.pixel, strict=True)]
    if max(size) > _FULL * _COARSE * job.frame.pixel[0]:
        return camera
    pixels = camera.resolution
    width = max(pixels) * max(s / n for s, n in zip(size, pixels, strict=True))
    return camera.replace(
        width=_rounded(width / _FILLED, width),
        shift=tuple(_rounded(0.5 * (a + b), width) for a, b in limits),
    )


def first_camera(
    volume: Any, incl: Any = None, phi: Any = None, *, view: str | None = None
) -> Orthographic:
    """Return a camera that sees all of a volume from given angles, or in a view; see `framed`."""
    given = {name: v for name, v in (("incl", incl), ("phi", phi)) if v is not None}
    if view is not None and given:
        raise InputError(f"give angles or view={view!r}, not both")
    angles = view_angles(getattr(volume, "meta", {}), view)
    if given:
        angles = {"incl": FIRST_INCL, "phi": FIRST_PHI} | given
    return Orthographic(**angles)


def _limits(light: np.ndarray, frame: Any) -> list[tuple[float, float]]:
    """Return between which coordinates of the image plane something shines, along both axes."""
    seen = np.where(light > _FAINT * light.max(), light, 0.0)
    ends = [_span(seen.sum(axis=a)) for a in (0, 1)]
    return [(axis[a], axis[b]) for axis, (a, b) in zip(frame.coordinates(), ends, strict=True)]


def _span(light: np.ndarray) -> tuple[int, int]:
    total = np.cumsum(light) / max(light.sum(), 1e-300)
    first, last = np.searchsorted(total, [_WISPS, 1.0 - _WISPS])
    return int(first), int(min(last, len(light) - 1))


def _rounded(value: float, size: float) -> float:
    """Return a length to a thousandth of the frame: it is shown, and typed again."""
    return round(float(value), 3 - int(np.floor(np.log10(size))))
