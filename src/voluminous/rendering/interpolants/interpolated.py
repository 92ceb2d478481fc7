"""Fields interpolated along rays, and a medium that classifies them there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr
from ...backend.types import Float
from ...expressions import Expression
from ...grids.cartesian.dual_walk import Chord
from ...grids.contract import Segment
from ...media.context import Context
from ...media.edges import Level
from ...media.stretch import Panel, Straight, Stretch, with_coordinates, within_limits
from ...schemes.path import Path, layer
from ..coefficients.classify import Classifier
from .lattice import Corners


@dataclass
class FieldsAlong:
    """All fields along a segment, from their values at the corners of its dual cell."""

    source: Interpolated
    chord: Chord
    corners: dict[str, Corners]

    def at_begin(self) -> dict[str, Float]:
        """Return every field at the beginning of the segment."""
        return self.source.values(self.chord, self.corners, 0.0)

    def at_end(self) -> dict[str, Float]:
        """Return every field at the end of the segment."""
        return self.source.values(self.chord, self.corners, 1.0)

    def polynomials(self, *, rough: bool = False) -> dict[str, list[Float]]:
        """Return every field as a polynomial of s from 0 to 1; see `Interpolated.cubics`."""
        return self.source.cubics(self.chord, self.corners, rough=rough)


class Interpolated:
    """What a scheme on interpolated fields gets its coefficients from.

    Attributes
    ----------
    numbers : Direct or Shapes
        What is integrated.
    scalars : tuple of Expression
        What is carried from one stretch to the next.
    tolerance : tuple of arrays
        The errors of emission and transparency allowed in the first stretch of a ray, and what part
        of a pixel's those are (`schemes.in_front`).
    neglected, neglected_depth : float
        What faint places that are left out may emit and absorb along a ray, in all.
    lost : float
        The part of a pixel that the interpolation itself may be off by.
    """

    def __init__(
        self,
        classifier: Classifier,
        lattices: dict[str, Any],
        context: Context,
        blocks: Any,
        paths: float,
    ) -> None:
        self.classifier, self.lattices, self.context = classifier, lattices, context
        self.numbers, self.backend = classifier.numbers, classifier.backend
        self.blocks = blocks
        self.walk: Any = None  # through less than the whole grid, or in other steps
        self.walk_kind = "coarse" if blocks is not None and blocks.coarse else "dual"
        self.tolerance: tuple[Any, ...] = ()
        self.lost = 0.0
        # A ray that never comes nearer to a shell than where it is neglected may pass along it
        # all the way.
        most = 1e-3 * float(np.finfo(self.backend.dtype).max)
        self.neglected = min(paths * context.faint * self.numbers.one_path(), most)
        self.neglected_depth = min(paths * context.faint * self.numbers.one_depth(), 1.0)
        self.largest = self.bounds = self.numbers.in_units(classifier.largest())
        self.looks_inside = classifier.medium.looks_inside
        self.scalars: tuple[Expression, ...] = classifier.medium.scalars()
        self.units = {
            name: context.number(lattice.unit)
            for name, lattice in lattices.items()
            if lattice.unit != 1.0
        }
        names = classifier.medium.names
        every = "r" in names or bool(context.coordinates)
        self.coordinates = [a for a, axis in enumerate("xyz") if axis in names or every]

    def allow(self, emission: float, transparency: float, share: float) -> None:
        """Set the errors allowed in a pixel, and a segment's share; infinite ones never are."""
        o = self.backend.opaque
        most = 0.5 * float(np.finfo(self.backend.dtype).max)
        allowed = (min(share * error, most) for error in (emission, transparency))
        self.tolerance = (*map(o, allowed), o(share))

    def inputs(self) -> Any:
        return self.lattices, self.units, self.context.limits, self.tolerance, self.numbers.inputs()

    def along(self, segment: Segment) -> FieldsAlong:
        """Return the fields around the dual cell of a segment."""
        chord = segment.walk.chord(segment.track, segment)
        active = segment.active
        corners = {name: lattice.corners(chord, active) for name, lattice in self.lattices.items()}
        return FieldsAlong(self, chord, corners)

    def values(self, chord: Chord, corners: dict[str, Corners], s: float) -> dict[str, Any]:
        """Return every field at the beginning (0) or the end (1) of a segment."""
        found = {
            name: self._value(name, self.lattices[name].at(chord, c, s))
            for name, c in corners.items()
        }
        for a in self.coordinates:
            here = chord.position[a] + chord.step[a] if s else chord.position[a]
            found["xyz"[a]] = self.context.real(here)
        return with_coordinates(within_limits(found, self.context), self.context)

    def cubics(
        self, chord: Chord, corners: dict[str, Corners], *, rough: bool = False
    ) -> dict[str, list[Any]]:
        """Return every field along a segment, as a polynomial of s from 0 to 1.

        Where it is none, it is one to fourth order, or to third if that is enough (`rough`).
        """
        found = {
            name: self.lattices[name].along(chord, c, rough=rough) for name, c in corners.items()
        }
        for a in self.coordinates:
            found["xyz"[a]] = [chord.position[a], chord.step[a]]
        return found

    def stretch(self, cubics: dict[str, list[Any]], length: Any, *, rough: bool = False) -> Stretch:
        """Return a stretch of ray, for fields in the type that expressions are evaluated in."""
        return Stretch(self._own(cubics), self.context, length, rough=rough)

    def straight(self, cubics: dict[str, list[Any]], length: Any) -> Straight:
        """Return the same with scalars taken as linear."""
        return Straight(self._own(cubics), self.context, length)

    def _own(self, cubics: dict[str, list[Any]]) -> dict[str, list[Any]]:
        return {name: [self._value(name, v) for v in c] for name, c in cubics.items()}

    def _value(self, name: str, value: Any) -> Any:
        value = self.context.real(value)
        return value * self.units[name] if name in self.units else value

    def means(self, panel: Panel) -> tuple[list[Any], list[Any]]:
        """Return mean j and α over a panel, per length of the grid's scale."""
        j, alpha = self.numbers.split(self.numbers.means(panel, self.context))
        # What no physics can use becomes NaN, which the picture shows: it is looked at afterwards.
        return j, [dr.select(a >= 0.0, a, math.nan) for a in alpha]

    @property
    def smooth(self) -> bool:
        """Whether means of samples will do for some stretches, and it is known for which.

        Double precision is for those who want digits: panels have all of them in linear fields.
        """
        return self.backend.precision == "single" and self.classifier.medium.sampling.smooth

    @property
    def edges(self) -> list[Level]:
        """Where the medium jumps."""
        return self.classifier.medium.discontinuities(self.context)

    @property
    def linear(self) -> bool:
        """Whether closed forms are best where scalars are linear."""
        return self.classifier.medium.sampling.linear

    @property
    def hollow(self) -> bool:
        """Whether there is nothing between edges."""
        return self.classifier.medium.surface_only

    @property
    def layered(self) -> bool:
        """Whether something is without width."""
        return any(part.surface_only for part in self.classifier.medium.components())

    def layer(self, stretch: Stretch, place: Any) -> Path:
        """Return what has no width and is passed on a stretch, as it is at a place."""
        found = self.classifier.medium.layer(stretch, self.context, place)
        assert found is not None  # `layered`
        return layer(*self.numbers.split(found.listed()))

    @property
    def quick(self) -> bool:
        """Whether there is a rule of fewer samples."""
        return self.classifier.medium.sampling.quick

    @property
    def finer(self) -> bool:
        """Whether samples will do for parts of the others."""
        return self.classifier.medium.sampling.finer

    def sampled(self, stretch: Stretch, *, fine: bool) -> list[tuple[list[Any], list[Any]]]:
        """Return mean, first and last j and α of a stretch, and how far the means may be off."""
        found = self.numbers.sampled(stretch, self.context, fine=fine)
        return [self.numbers.split(own) for own in found]

    def cores(self, stretch: Stretch) -> list[list[Any]]:
        """Return how many structures are in each half of a stretch, for each part of a sum."""
        return [part.cores(stretch, self.context) for part in self.classifier.medium.components()]

    def shares(self, path: Path, panel: Panel) -> list[tuple[Any, Any]]:
        """Return the brightness and the optical depth of each part of a sum on a solved panel."""
        return self.numbers.shares(path, panel, self.context)

    @property
    def steady(self) -> bool:
        """Whether what an opaque medium shows is the same everywhere."""
        parts = self.classifier.medium.components()
        return len(parts) == 1 and parts[0].constant_source_function

    def sharpness(self, stretch: Stretch) -> tuple[Any, Any]:
        """Return how thin the medium's structures are, and how far bends may put means off."""
        return self.classifier.medium.sharpness(stretch, self.context)

    def visible(self, stretch: Stretch) -> tuple[Any, Any]:
        """Return where the medium may be noticeable, and where panels may not show that."""
        return self.classifier.medium.visible(stretch, self.context)
