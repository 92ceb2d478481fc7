"""The interface of media: from field values to emissivity j and extinction α, per unit length."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..notebook import picture
from ..packages import room
from ..units import Unit
from ..units import unit_of as unit_of_value
from ..value import Value
from .arguments import described, with_plain_expressions
from .context import Context, Feature, Halves, MediumSample, no_unit
from .panel import NODES, PLACES, kept
from .quadrature import doubled, simpson, with_values
from .ranges import Bounds, RangeContext, intervals

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..bounds.enclosure import EnclosedPanel, EnclosureContext, PanelBounds
    from ..evaluation import Evaluation
    from ..volume import Volume
    from .jumps import Jump
    from .modulation import Modulation
    from .panel import Panel
    from .shading import Shade


class Medium(Value):
    """A rule from field values to (j, α); media add with ``+``.

    Only `coefficients` and `key` are required. `features`, `ranges`, `means` and `visible` make a
    medium fast and give it error estimates; the rest refines these.

    Attributes
    ----------
    channels : int
        Number of channels of the emissivity.
    grey : bool
        True if one extinction serves all channels.
    names : tuple of str
        The fields and coordinates it depends on.
    discrete : bool
        True if its values are labels, which must not be interpolated: the default scheme is then
        ``"first-order"``.
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
    order : int
        Order of convergence of `means` in the length of panels.
    kind : str
        Its type in scene files; the name of the class by default.
    thermal : bool
        Its source function is at most one in each channel.
    sight : tuple of str
        Axes whose directions relative to the line of sight it needs: ``fields["los.r"]`` is the
        cosine between r and the line of sight, away from the observer.
    """

    channels: int
    grey: bool
    names: tuple[str, ...]
    discrete: bool = False
    path_length: Any = None
    modulation: Modulation | None = None
    shade: Shade | None = None
    sensitivity: float = 1.0
    order: int = 4
    kind: ClassVar[str] = ""
    thermal: bool = False
    sight: tuple[str, ...] = ()

    # --- required -----------------------------------------------------------------------------

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        """Return j and α per unit length for arrays of field values (traced by Dr.Jit)."""
        raise NotImplementedError

    def key(self) -> Any:
        """Return a hashable value that identifies this medium, or None if there is none.

        Tabulated coefficients and traced kernels are reused for media with the same key, so the
        key must contain everything on which `coefficients` and the other methods depend.
        """
        raise NotImplementedError

    # --- for speed: which expressions it uses, and where it shows ------------------------------

    def features(self) -> tuple[Feature, ...]:
        """Return all expressions that it evaluates; empty if unknown.

        The first is that of which it is a function, if that has colours.
        """
        return ()

    def known_features(self) -> tuple[Feature, ...]:
        """Return the features of all components."""
        return tuple(feature for part in self.components() for feature in part.features())

    def scalars(self) -> tuple[Expression, ...]:
        """Return the expressions that `means` interpolates linearly over a panel."""
        return tuple({f.expr.text: f.expr for f in self.features() if f.scalar}.values())

    @property
    def looks_inside(self) -> bool:
        """Whether `means` evaluates fields between a panel's ends."""
        return not self.features() or not all(f.scalar for f in self.features())

    def ranges(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        """Return intervals that hold j and α while the fields stay in theirs; default: unbounded.

        A medium whose `coefficients` only uses operators, `Context.ops` and
        `Context.interpolate` returns ``self.coefficients(...)``.
        """
        return self.split(
            [Interval(-np.inf, np.inf)] * self.channels
            + [Interval(0.0, np.inf)] * self.extinction_count
        )

    def largest(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        """Return upper bounds of |j| and α on a ray while the fields stay in ranges (NumPy)."""
        values = self.ranges(fields, context).listed()
        return self.split([np.where(value.nan, np.inf, value.size) for value in values])

    def visible_in(self, fields: dict[str, Interval], context: Context) -> Mask:
        """Return where it may be noticeable while the fields stay in ranges (NumPy, a mask).

        Default: where its coefficients may be other than zero.
        """
        values = self.ranges(fields, context).listed()
        return functools.reduce(operator.or_, (v.nan | (v.size > 0.0) for v in values))

    def visible_key(self) -> Any:
        """Return a key of all that `visible_in` depends on except the fields; None if unknown."""
        return self.key()

    def emission_range(self) -> tuple[float, float] | None:
        """Return the least and largest emission of one path length; None if unknown."""
        return None

    def strongest(self) -> tuple[float, float]:
        """Return the brightness and opacity of one path length at the peak; 0 without a peak."""
        return 0.0, 0.0

    @property
    def spectral(self) -> bool:
        """Whether each channel is a picture of its own, with its own unit and tolerance.

        The channels of a medium whose `emission_range` is known are colours of one picture.
        """
        return all(part.emission_range() is None for part in self.components())

    def group(self, first: int, last: int) -> Medium:
        """Return the medium of the channels from `first` up to `last`, which are drawn together."""
        some: Medium = room("media.some_channels").SomeChannels(self, first, last)
        return some

    def prominence(self, x: Float, context: Context) -> Float:
        """Return its strength at a value of the only scalar, relative to the peak, from 0 to 1.

        Without error control steps may be wide where this is small. Default: one.
        """
        return x * 0.0 + 1.0

    def used_names(self) -> tuple[str, ...]:
        """Return the fields and coordinates that its expressions depend on."""
        used = [name for feature in self.features() for name in feature.expr.names]
        return tuple(dict.fromkeys((*used, *(self.modulation.names if self.modulation else ()))))

    def on_rays(self) -> Medium:
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

    # --- for speed and error estimates: means over panels of a ray -----------------------------

    def means(self, panel: Panel, context: Context) -> MediumSample:
        """Return the means of j and α over a panel of a ray (traced by Dr.Jit).

        Per `context.scale` of length, emission in units of `context.radiance`. Default: Simpson's
        rule, exact for polynomials of degree three.
        """
        rows = [self.at(panel, s, context) for s in NODES]
        return self.split([simpson(*with_values(values)) for values in zip(*rows, strict=True)])

    def integrate(self, panel: Panel, context: Context) -> Halves:
        """Return the means over both halves of a panel, and the error of the mean over it.

        Default: Simpson's rule for the panel and for its halves.
        """
        rows = [self.at(panel, s, context) for s in PLACES]
        found = []
        for values in zip(*rows, strict=True):
            a, b, c, d, e = with_values(values)
            sums = simpson(a, c, e), simpson(a, b, c), simpson(c, d, e)
            found.append(doubled(*sums, self.order, panel.many))
        return Halves(*(self.split(list(values)) for values in zip(*found, strict=True)))

    @property
    def extinction_count(self) -> int:
        """Number of extinctions: one if grey, else one per channel."""
        return 1 if self.grey else self.channels

    def split(self, values: list[Float]) -> MediumSample:
        """Return a list of values, j of all channels first, as coefficients."""
        return MediumSample(values[: self.channels], values[self.channels :])

    def everywhere(self, value: Float) -> MediumSample:
        """Return coefficients that all have one value."""
        return self.split([value] * (self.channels + self.extinction_count))

    def at(self, panel: Panel, s: float, context: Context) -> list[Float]:
        """Return j, then α, at a place of a panel in the units of `means`."""
        return self.in_units(self.coefficients(panel.fields(s), context), context)

    def in_units(self, sample: MediumSample, context: Context) -> list[Float]:
        """Return coefficients per unit length in the units of `means`."""
        bright, dense = context.keep(
            "units",
            lambda: (
                [context.number(u) for u in np.atleast_1d(context.scale / context.radiance)],
                context.number(context.scale),
            ),
        )
        # A negative extinction becomes NaN, even where the mean would hide it.
        usable = [dr.select(a >= 0.0, a, math.nan) for a in sample.extinction]
        if len(bright) == 1:
            bright = bright * self.channels
        values = [unit * j for unit, j in zip(bright, sample.emissivity, strict=True)]
        values += [dense * a for a in usable]
        return [context.narrow(v) for v in values]

    def panel_bounds(self, panel: EnclosedPanel, context: EnclosureContext) -> list[PanelBounds]:
        """Return guaranteed bounds on a panel, of each of its components.

        Default: from the ranges of the coefficients, whose width falls with the length of the
        panel; the means of most media have narrower bounds, which fall with its square.
        """
        values = self.ranges(panel.fields, context)
        return [panel.bounds(values, values)]

    def jumps(self, context: Context) -> list[Jump]:
        """Return the levels at which the medium jumps or has a surface without width.

        Panels end there: `means` is called for panels without a discontinuity inside
        (`Panel.without_jumps`).
        """
        return self.modulation.jumps(context) if self.modulation else []

    def layer(self, panel: Panel, context: Context, place: Float) -> MediumSample | None:
        """Return emission and depth of the infinitely thin surfaces crossed; None if it has none.

        In the units of `means` times length, without absorption; evaluated at a place s, 0 to 1.
        """
        return None

    @property
    def surface_only(self) -> bool:
        """Whether the medium consists only of surfaces without width."""
        return False

    @property
    def constant_source_function(self) -> bool:
        """Whether j/α is the same everywhere: an opaque medium then looks the same everywhere."""
        return False

    def warmth(self, panel: Panel, context: Context) -> list[Float] | None:
        """Return temperatures on a panel between which all matter is; None if that is unknown."""
        return None

    def spread_between(self, warmth: list[Float], context: Context) -> list[Float] | None:
        """Return the relative change of the source function between temperatures, per channel."""
        return None

    def source_spread(self, panel: Panel, context: Context) -> list[Float] | None:
        """Return how much the source function may change over a panel; None if that is unknown."""
        warmth = self.warmth(panel, context)
        return None if warmth is None else self.components()[0].spread_between(warmth, context)

    def visible(self, panel: Panel, context: Context) -> tuple[Mask, Mask]:
        """Return (visible, unresolved), two masks.

        Visible: lanes on which the medium may contribute. Unresolved: those on which structure
        between the nodes may be missed, so that the panel must be halved. On a `culling_only` panel
        gates do not count.
        """
        active = panel.length >= 0.0
        return active, active & False

    # --- units, parts, scene files --------------------------------------------------------------

    def intensity_unit(self, context: Context) -> Unit:
        """Return the unit of emissivity times length; None where colours are plain numbers."""
        return None

    def profile(
        self, unit: Unit, extent: Callable[[], tuple[float, float]]
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the medium as a function of its only scalar, in `unit`: nodes and heights.

        Linear in between, zero outside, in any unit; two equal nodes make a jump. `extent` returns
        the scalar's least and greatest value in the volume, for profiles without an end. Default:
        None, which is for media without a path length.
        """
        return None

    def plain(self, volume: Evaluation, emission: Unit = None) -> Medium:
        """Return it with expressions that are plain numbers of a volume's fields.

        `emission` is the unit of its emissivity, where that can be converted; default: as it is.
        """
        return with_plain_expressions(self, volume)

    def length_unit(self, unit_of: Callable[[Expression], Unit]) -> Unit:
        """Return the unit of length in which it is given, if any: that of its path length."""
        return unit_of_value(self.path_length)

    def scaled(self, factor: float) -> Medium:
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

    def components(self) -> tuple[Medium, ...]:
        """Return the media this one is the sum of."""
        return (self,)

    def formulas(self) -> Medium | None:
        """Return the medium with its Python function as expressions, if possible; else None."""
        return None

    def describe(self) -> dict[str, Any]:
        """Return the medium as plain values, as in a scene file: its arguments by default."""
        return {"type": self.kind or type(self).__name__.lower(), **described(self)}

    # --- for users ------------------------------------------------------------------------------

    def bounds(
        self,
        lo: Mapping[str, Any],
        hi: Mapping[str, Any],
        unit: Unit = None,
        unit_of: Callable[[Expression], Unit] = no_unit,
    ) -> Bounds:
        """Return bounds of j and α over ranges of the fields, for example of blocks of cells.

        Each field takes every value of its range, independently of the others. The bounds hold with
        certainty for coefficients computed in double precision. Where one may be NaN they are
        infinite.

        Parameters
        ----------
        lo, hi : mapping of str to array_like
            Smallest and largest value of every field in `names`, plain numbers in the fields' own
            units; any shapes that broadcast. A block with NaN in it has NaN there.
        unit : astropy unit or None
            The volume's length unit.
        unit_of : callable, optional
            Returns the unit of an `Expression`, or None, as `Volume.expression_unit` does.

        Returns
        -------
        Bounds
            Per channel, arrays of the ranges' common shape.

        Raises
        ------
        InputError
            If a smallest value is above the largest, or shapes do not fit.
        UnknownNameError
            If a field is missing.
        """
        whole: Medium = room("media.function").with_formulas(self)
        fields = intervals(lo, hi)
        with np.errstate(all="ignore"):
            return Bounds.of(whole.ranges(fields, RangeContext(unit, unit_of)), fields)

    def __add__(self, other: Any) -> Medium:
        if not isinstance(other, Medium):
            return NotImplemented
        total: Medium = room("media.sum").Sum(self.components() + other.components())
        return total

    def __radd__(self, other: Any) -> Medium:
        # sum([...]) starts from 0.
        return self if isinstance(other, int) and other == 0 else NotImplemented

    def __call__(self, values: Any) -> tuple[Any, Any]:
        """Return j and α per unit length at values of its fields or expressions.

        Parameters
        ----------
        values : array_like, Quantity or dict of str to these
            Values of its expression, if it is a function of one; or of all fields that it uses (or
            whole expressions) by name, of one shape.

        Returns
        -------
        j : float64 array or Quantity, shape (channel, …)
        alpha : float64 array or Quantity, shape (…) if it is grey, else (channel, …)
            With units where lengths or fields have units; per path length if it is ``"auto"``.

        Raises
        ------
        InputError
            If values of a field or expression are missing, or some path lengths are ``"auto"`` and
            others are not.
        UnitsError
            If units do not fit.

        Examples
        --------
        >>> import voluminous as vm
        >>> j, alpha = vm.Gaussian("density", 2.0, 0.5, (1.0, 0.5, 0.0), 0.3)([1.5, 2.0])
        >>> j.shape, alpha.round(4)
        ((3, 2), array([0.182, 0.3  ]))
        """
        j, alpha = room("calibration.at_values").evaluate(self, values)
        return j, alpha

    def calibrated(self, volume: Volume) -> Medium:
        """Return this medium with numbers for all parameters that are measured in a volume.

        Each ``path_length="auto"`` becomes the median thickness of the medium's shell in this
        volume, so that one crossing of the shell shows its colour and its opacity. Open ends of
        the range of a `ColorBy` or `Colormap` are set so that the range holds 99 % of what the
        medium shows, by volume. Units in expressions are converted. The same volume gives the
        same numbers on every machine.

        Parameters
        ----------
        volume : Volume
            The volume in which thicknesses are measured.

        Returns
        -------
        Medium
            Path lengths are plain numbers in the volume's unit, and so are numbers in expressions
            such as ``where="velocity_z > 5 km/s"``. The medium itself if nothing was open.

        Raises
        ------
        InputError
            If `volume` is no volume, or there is no range of colours.
        UnknownNameError
            If the medium uses a field that does not exist.
        UnitsError
            If the unit of an expression cannot be derived.

        Notes
        -----
        Thickness is the effective width in x over the gradient of x, as a median weighted by
        area. A shell that does not occur in the volume gets the shortest side of the domain.

        Examples
        --------
        >>> import voluminous as vm
        >>> core = vm.models.prestellar_core(32)
        >>> shell = vm.Gaussian("log10(density)", 3.5, 0.05, 1.0, 0.1, path_length="auto")
        >>> f"{shell.calibrated(core).path_length:.2g} cm"
        '4.2e+16 cm'
        """
        result: Medium = room("calibration.open_numbers").calibrate(self, volume)
        return result

    def plot(self, volume: Volume | None = None, ax: Any = None) -> Axes | np.ndarray:
        """Draw j and α over the values of its expressions, with the number of cells at each.

        One panel for each expression. Gates, and colours by other expressions, are named and not
        drawn. Where the medium is a function of several fields, medians over the cells are drawn.

        Parameters
        ----------
        volume : Volume, optional
            Parameters that are ``"auto"`` or open are measured in it, as in `calibrated`. Without
            it the plot has no histogram and shows the values for one path length.
        ax : matplotlib Axes or sequence of them, optional
            Where to draw; one is divided if there are several panels. Default: a new figure, shown
            by notebooks and ``plt.show()`` if pyplot is in use.

        Returns
        -------
        matplotlib Axes, or an array of them if there are several panels
            For j, on the left; α, on the right, has separate axes.

        Raises
        ------
        InputError
            If the medium is invisible in the volume, or if no volume and no range is given.
        """
        axes: Axes | np.ndarray = room("calibration.transfer").plot(self, volume, ax)
        return axes

    @staticmethod
    def from_function(
        function: Callable[..., Any],
        fields: Any,
        channels: int,
        *,
        grey: bool = True,
        parameters: dict[str, float] | None = None,
        units: Any = None,
    ) -> Medium:
        """Return a medium from any Python function of the fields; see `media.Function`."""
        medium: Medium = room("media.function").Function(
            function, fields, channels, grey=grey, parameters=parameters, units=units
        )
        return medium

    def _repr_png_(self) -> bytes | None:
        data: bytes | None = room("calibration.transfer").swatch(self)
        return data

    def _swatch(self) -> str:
        data = self._repr_png_()
        title = room("calibration.transfer").swatch_title
        return "" if data is None else picture(data, title(self))

    def __repr__(self) -> str:
        given = self.arguments()
        shown = {k: v for k, v in self.describe().items() if k != "type"}
        shown |= {k: given[k] for k in shown if isinstance(given.get(k), Value)}
        return f"{type(self).__name__}({', '.join(f'{k}={v!r}' for k, v in shown.items())})"


def integrated(medium: Medium, panel: Panel, context: Context) -> Halves:
    """Return the integrals of a medium over both halves of a panel; computed once."""
    return kept(panel, (id(medium), "integrated"), lambda: medium.integrate(panel, context))
