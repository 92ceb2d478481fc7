"""One frame of a film: it is drawn and written in this process, or by a worker in another one."""

from __future__ import annotations

import functools
import operator
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..cameras import Camera
from ..cameras.contract import pixel_counts
from ..errors import InputError
from ..executors import Sent
from ..image import Image, metadata
from ..image.annotate.marks import readable_unit
from ..measuring.projections import drawn
from ..media.contract import Medium
from ..units import is_count
from ..volume import Volume

# Sides of coarse pictures in pixels.
_COARSE = 100
# One picture at a time: kernels use all threads, and two pictures twice the memory.
_drawing = threading.Lock()


@dataclass(frozen=True)
class Frame:
    """What is drawn, how, and where to: all but the volume.

    Attributes
    ----------
    noted : dict
        Added to the provenance of the picture.
    """

    medium: Medium
    camera: Camera
    options: dict[str, Any]
    picture: dict[str, Any]
    finish: Callable[[Image], Image] | None
    path: Path
    noted: dict[str, Any]

    def image(self, volume: Volume | Sent) -> Image:
        """Return the picture."""
        with _drawing:
            volume = volume_of(volume.value if isinstance(volume, Sent) else volume)
            options = {"progress": False, **self.options}
            image = drawn(volume, self.medium, self.camera, options.pop("project", None), **options)
            image = image if self.finish is None else self.finish(image)
            if not isinstance(image, Image):
                raise InputError(f"finish must return an image, got {type(image).__name__}")
        return image.replace(provenance={**(image.provenance or {}), **self.noted})

    def coarse(self) -> Frame:
        """Return the frame with few pixels of about the same shape, quickly drawn.

        Of a file with levels a coarse one is read.
        """
        camera = self.camera
        pair = pixel_counts(camera.arguments().get("resolution", _COARSE))
        if max(pair) > _COARSE:
            nx, ny = (max(1, round(n * _COARSE / max(pair))) for n in pair)
            camera = camera.within((nx, ny))
        quick = {"level": "auto", **self.options, "tolerance": None, "bounds": False}
        return replace(self, camera=camera, options=quick)


def volume_of(given: Any) -> Volume:
    """Return a volume, or the one that a function returns."""
    volume = given() if callable(given) else given
    if not isinstance(volume, Volume):
        raise InputError(f"{given!r} must return a Volume, got {type(volume).__name__}")
    return volume


def draw(frame: Frame, volume: Volume | Sent) -> None:
    """Draw and write a frame."""
    frame.image(volume).save(frame.path, **frame.picture)


def display(frame: Frame, volume: Volume | Sent) -> tuple[float, float, float, str]:
    """Return the least and the largest intensity, the exposure, and a unit for a scale bar."""
    image = frame.coarse().image(volume)
    finite = image.intensity[np.isfinite(image.intensity)]
    return float(finite.min()), float(finite.max()), image.exposure, readable_unit(image) or ""


def provenance(path: Path) -> dict[str, Any]:
    """Return how a picture was made; {} if it is missing, damaged, or another program's."""
    if not path.is_file():
        return {}
    try:
        if path.suffix.lower() != ".png":
            return Image.load(path).provenance or {}
        from PIL import Image as Pillow

        with Pillow.open(path) as file:  # reads the texts; pixels are not unpacked
            text, size = file.info.get(metadata.KEY), file.size
            file.verify()
        return metadata.loads(text, (size[1], size[0], 3)).get("provenance") or {}
    except Exception:
        return {}


# Components weaker than this are left out.
_LEAST = 1e-4


def fade(first: Medium, last: Medium, frames: int) -> list[Medium]:
    """Return media that go from one to the other: one per frame.

    Emission and extinction are ``(1 - t)`` those of the first and ``t`` those of the last, with t
    from 0 to 1. Components that both have are constant.

    Parameters
    ----------
    first, last : Medium
        With the same number of channels, and path lengths that are numbers (`Medium.calibrated`).
    frames : int
        Number of media.

    Returns
    -------
    list of Medium

    Raises
    ------
    InputError
        If a path length is "auto", or a medium is a Python function.
    """
    if not is_count(frames, 1 << 31):
        raise InputError(f"frames must be a positive whole number, got {frames!r}")
    if not (isinstance(first, Medium) and isinstance(last, Medium)):
        raise InputError(f"fade goes from a medium to a medium, got {first!r} and {last!r}")
    going = [one for one in first.components() if one not in last.components()]
    coming = [one for one in last.components() if one not in first.components()]
    staying = [one for one in first.components() if one in last.components()]
    weights = map(float, np.linspace(0.0, 1.0, frames))
    return [
        functools.reduce(
            operator.add,
            staying
            + [one.scaled(1.0 - t) if t else one for one in going if 1.0 - t > _LEAST]
            + [one.scaled(t) if t < 1.0 else one for one in coming if t > _LEAST],
        )
        for t in weights
    ]
