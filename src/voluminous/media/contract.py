"""The contract of media: recipes of j and α, with units; `media.bound` is what kernels see."""

from __future__ import annotations

from typing import Any

from .arguments import described
from .bound import Binding, BoundMedium, Wrapped
from .context import Feature, MediumSample
from .details import Details
from .sugar import Sugar

__all__ = ["Medium", "MediumSample"]


class Medium(Sugar, Details):
    """A rule from field values to emissivity j and extinction α; media add with ``+``.

    Required are `channels`, `grey` and `key`, and `bind`, or in its place `coefficients` and
    ``names``, the fields that it depends on. `Details` has what else is asked of media.

    Attributes
    ----------
    channels : int
        Number of channels of the emissivity.
    grey : bool
        True if one extinction serves all channels.
    """

    channels: int
    grey: bool

    def features(self) -> tuple[Feature, ...]:
        """Return all expressions that it evaluates; empty if unknown.

        The first is that of which it is a function, if that has colours.
        """
        return ()

    def bind(self, binding: Binding) -> BoundMedium:
        """Return the medium as numbers, in a volume's units and a kernel's.

        Default: by `coefficients` and `ranges`, which are per unit of the volume's length.
        """
        return Wrapped(self, binding)

    def key(self) -> Any:
        """Return a hashable value that identifies this medium, or None if there is none.

        Tabulated coefficients and traced kernels are reused for media with the same key, so the
        key must contain everything on which they depend, besides the volume.
        """
        raise NotImplementedError

    def describe(self) -> dict[str, Any]:
        """Return the medium as plain values, as in a scene file: its arguments by default."""
        return {"type": self.kind or type(self).__name__.lower(), **described(self)}

    def components(self) -> tuple[Medium, ...]:
        """Return the media this one is the sum of."""
        return (self,)
