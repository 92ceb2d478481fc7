"""What users do with media: add, evaluate, plot, bound and calibrate them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..expressions import Expression
from ..notebook import picture
from ..units import Unit
from ..value import Value
from .bound import Binding, no_unit
from .ranges import Bounds, RangeContext, intervals

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..volume import Volume
    from .contract import Medium


class Sugar(Value):
    """What users do with media."""

    def bounds(
        self: Any,
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
        from .function import with_formulas

        whole, fields = with_formulas(self), intervals(lo, hi)
        with np.errstate(all="ignore"):
            found = whole.bind(Binding(unit, unit_of)).coefficients(fields, RangeContext())
            return Bounds.of(found, fields)

    def __add__(self: Any, other: Any) -> Medium:
        from .sum import Sum

        if not isinstance(other, Sugar):
            return NotImplemented
        both: Any = other
        return Sum(self.components() + both.components())

    def __radd__(self, other: Any) -> Any:
        # sum([...]) starts from 0.
        return self if isinstance(other, int) and other == 0 else NotImplemented

    def __call__(self: Any, values: Any) -> tuple[Any, Any]:
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
        from ..calibration.at_values import evaluate

        return evaluate(self, values)

    def calibrated(self: Any, volume: Volume) -> Medium:
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
        from ..calibration.open_numbers import calibrate

        return calibrate(self, volume)

    def plot(self: Any, volume: Volume | None = None, ax: Any = None) -> Axes | np.ndarray:
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
        from ..calibration.transfer import plot

        axes: Axes | np.ndarray = plot(self, volume, ax)
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
        from .function import Function

        return Function(function, fields, channels, grey=grey, parameters=parameters, units=units)

    def _repr_png_(self: Any) -> bytes | None:
        from ..calibration.transfer import swatch

        return swatch(self)

    def _swatch(self: Any) -> str:
        from ..calibration.transfer import swatch_title

        data = self._repr_png_()
        return "" if data is None else picture(data, swatch_title(self))

    def __repr__(self) -> str:
        given = self.arguments()
        shown = {k: v for k, v in self.describe().items() if k != "type"}
        shown |= {k: given[k] for k in shown if isinstance(given.get(k), Value)}
        return f"{type(self).__name__}({', '.join(f'{k}={v!r}' for k, v in shown.items())})"
