"""What is asked of media besides their contract; all of it has defaults."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..units import Unit, plain
from ..units import described as plain_values
from ..units import unit_of as unit_of_value
from ..value import Value
from .arguments import with_plain_expressions
from .context import Context, Feature, MediumSample

if TYPE_CHECKING:
    from ..evaluation import Evaluation
    from .contract import Medium
    from .modulation import Modulation
    from .shading import Shade


@dataclass(eq=False)
class Colors:
    """The colours of a medium at values of an expression, for plots and colour bars.

    Attributes
    ----------
    values : array_like or Quantity, shape (n,)
        Values of the expression.
    rows : array_like, shape (n, channel), or None
        Emission there; None where another expression has the colours.
    half_width : float or Quantity, optional
        Half the width of a shell around each value. None: the colours in between are interpolated.
    opacities : sequence of float, optional
        What a crossing of each value takes away, of a surface; None for other media.
    is_open : bool
        The ends ``vmin`` and ``vmax`` of the range are measured in a volume.
    positive : bool
        Only positive values have colours.
    """

    values: Any
    rows: Any
    half_width: Any = None
    opacities: Sequence[float] | None = None
    is_open: bool = False
    positive: bool = False

    @property
    def unit(self) -> Unit:
        return unit_of_value(self.values)

    def values_in(self, unit: Unit) -> np.ndarray:
        return np.asarray(plain(self.values, unit, "values"))

    def closed(self, low: float, high: float, unit: Unit) -> dict[str, Any]:
        """Return arguments for the open ends of the range: numbers in a unit."""
        return {"vmin": low * (unit or 1), "vmax": high * (unit or 1)}

    def describe(self) -> dict[str, Any]:
        """Return what a colour bar shows, as plain values."""
        shown = {"values": self.values, "colors": self.rows, "half_width": self.half_width}
        return {name: plain_values(value) for name, value in shown.items() if value is not None}


class Details(Value):
    """Details of media, for those that have them.

    Attributes
    ----------
    names : tuple of str
        The fields and coordinates it depends on.
    discrete : bool
        True if its values are labels, which must not be interpolated: the default scheme, of a sum
        with others too, is then ``"second-order"``, which interpolates coefficients.
    path_length : float, Quantity or "auto", optional
        The length to which its colours and opacities refer, if any; ``"auto"`` until
        `Medium.calibrated` measures it, for media with a `profile`.
    modulation : Modulation, optional
        Its gate, and its colours by another expression.
    shade : Shade, optional
        The shading of its surfaces, unless it is part of the modulation.
    sensitivity : float
        Factor on the error of the fields at structures without width and at jumps: their places,
        and the values evaluated there, depend on the slopes of the fields.
    kind : str
        Its type in scene files; the name of the class by default.
    thermal : bool
        Its source function is at most one in each channel.
    sight : tuple of str
        Axes whose directions relative to the line of sight it needs: ``fields["los.r"]`` is the
        cosine between r and the line of sight, away from the observer.
    """

    names: tuple[str, ...]
    discrete: bool = False
    path_length: Any = None
    modulation: Modulation | None = None
    shade: Shade | None = None
    sensitivity: float = 1.0
    kind: ClassVar[str] = ""
    thermal: bool = False
    sight: tuple[str, ...] = ()

    if TYPE_CHECKING:  # of the contract
        channels: int
        grey: bool
        features: Callable[[], tuple[Feature, ...]]
        components: Callable[[], tuple[Medium, ...]]
        key: Callable[[], Any]

    # --- in place of `bind` ---------------------------------------------------------------------

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        """Return j and α per unit length for arrays of field values (traced by Dr.Jit)."""
        raise NotImplementedError

    def ranges(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        """Return intervals that hold j and α while the fields stay in theirs; default: unbounded.

        A medium whose `coefficients` only uses operators, `Context.ops` and
        `Context.interpolate` returns ``self.coefficients(...)``.
        """
        return MediumSample(
            [Interval(-np.inf, np.inf)] * self.channels,
            [Interval(0.0, np.inf)] * (1 if self.grey else self.channels),
        )

    # --- what follows from the features ---------------------------------------------------------

    def known_features(self) -> tuple[Feature, ...]:
        return tuple(feature for part in self.components() for feature in part.features())

    def scalars(self) -> tuple[Expression, ...]:
        """Return the expressions that panels interpolate linearly over a panel."""
        return tuple({f.expr.text: f.expr for f in self.features() if f.scalar}.values())

    @property
    def looks_inside(self) -> bool:
        """Whether means evaluate fields between a panel's ends."""
        return not self.features() or not all(f.scalar for f in self.features())

    def visible_key(self) -> Any:
        """Return a key of all that `may_show` depends on except the fields; None if unknown."""
        return self.key()

    def peak(self) -> tuple[float, float, float] | None:
        """Return the least and largest emission, and the optical depth, of one path length.

        None if they are not known.
        """
        return None

    @property
    def spectral(self) -> bool:
        """Whether each channel is a picture of its own, with its own unit and tolerance.

        The channels of a medium whose `peak` is known are colours of one picture.
        """
        return all(part.peak() is None for part in self.components())

    @property
    def surface_only(self) -> bool:
        """Whether the medium consists only of surfaces without width."""
        return False

    @property
    def constant_source_function(self) -> bool:
        """Whether j/α is the same everywhere: an opaque medium then looks the same everywhere."""
        return False

    def used_names(self) -> tuple[str, ...]:
        """Return the fields and coordinates that its expressions depend on."""
        used = [name for feature in self.features() for name in feature.expr.names]
        return tuple(dict.fromkeys((*used, *(self.modulation.names if self.modulation else ()))))

    def on_rays(self) -> Any:
        """Return the medium for schemes that need its light only on rays with known directions.

        The gradient along the line of sight, in all cells, took three times as long as the picture.
        """
        changes: dict[str, Any] = {}
        if self.modulation is not None and self.modulation.shade is not None:
            changes["modulation"] = self.modulation.on_rays()
        if self.shade is not None:
            changes["shade"] = self.shade.on_rays()
        if not changes:
            return self
        medium = self.changed(**changes)
        return medium.changed(names=medium.used_names())

    # --- units, calibration, films --------------------------------------------------------------

    def profile(
        self, unit: Unit, extent: Callable[[], tuple[float, float]]
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the medium as a function of its only scalar, in `unit`: nodes and heights.

        Linear in between, zero outside, in any unit; two equal nodes make a jump. `extent` returns
        the scalar's least and greatest value in the volume, for profiles without an end. Default:
        None, which is for media without a path length.
        """
        return None

    def plain(self, volume: Evaluation, emission: Unit = None) -> Any:
        """Return it with expressions that are plain numbers of a volume's fields.

        `emission` is the unit of its emissivity, where that can be converted; default: as it is.
        """
        return with_plain_expressions(self, volume)

    def length_unit(self, unit_of: Callable[[Expression], Unit]) -> Unit:
        """Return the unit of length in which it is given, if any: that of its path length."""
        return unit_of_value(self.path_length)

    def scaled(self, factor: float) -> Any:
        """Return it with emission and extinction multiplied by a factor, from 0 to 1.

        Default: a path length over that factor.
        """
        if self.path_length is None:
            raise InputError(f"{type(self).__name__} cannot fade; write it with expressions")
        if isinstance(self.path_length, str):
            raise InputError(
                "a medium that fades needs a path length; write medium.calibrated(volume)"
            )
        return self.replace(path_length=self.path_length / factor)

    def emission_unit(self, unit_of: Callable[[Expression], Unit]) -> Unit:
        """Return the unit of its emissivity; None where colours are plain numbers."""
        return None


def intensity_unit(medium: Medium, volume: Evaluation) -> Unit:
    """Return the unit of emissivity times a volume's length; None where colours are plain."""
    unit = medium.emission_unit(volume.expression_unit)
    return unit if unit is None or volume.unit is None else unit * volume.unit
