"""Planes through a grid, the values on them, and their pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..colormaps import get_colormap
from ..errors import InputError, immutable, unknown_name
from ..expressions import Expression, NumpyOps, components
from ..figures import add_color_bar, new_figure
from ..memory import check_memory
from ..notebook import page, picture, png, table
from ..units import Unit, is_count, plain, shown, unit_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..cameras.contract import Camera
    from ..grids.contract import Grid


_ALONG = 1 - 1e-12


@dataclass(frozen=True, repr=False)
class Slice:
    """Values on a plane.

    Attributes
    ----------
    values : array (ny, nx) or (3, ny, nx)
        Row 0 at the bottom; NaN outside the grid.
    extent : (float, float, float, float)
        left, right, bottom, top: for ``imshow(values, extent=extent, origin="lower")``.
    unit : str
        Of the values, empty if they have none.
    length_unit : str
        Of the extent.
    plane : Plane
        Where it is.
    name : str
        What is shown: a field or an expression.
    """

    values: np.ndarray
    extent: tuple[float, float, float, float]
    unit: str
    length_unit: str
    plane: Plane
    name: str = ""

    def plot(
        self,
        ax: Axes | None = None,
        *,
        colormap: Any = "viridis",
        norm: Any = None,
        vmin: Any = None,
        vmax: Any = None,
    ) -> Axes:
        """Draw the slice with axes in its unit of length, and a colour bar.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw. Default: a new figure, shown by notebooks and ``plt.show()`` if pyplot
            is in use; otherwise a figure without a window, for ``ax.figure.savefig(...)``.
        colormap : str or matplotlib.colors.Colormap
            From values to colours.
        norm : {"linear", "log"} or matplotlib.colors.Normalize, optional
            How values are spread over the colours.
        vmin, vmax : float or Quantity, optional
            Values of the first and the last colour; by default the least and the largest. Plain
            numbers are in the slice's unit.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        InputError
            If it is a slice of a vector, which has three pictures, or `norm` is none.
        UnknownNameError
            If there is no such colormap.
        UnitsError
            If a quantity cannot be converted to the slice's unit.
        """
        if self.values.ndim != 2:
            raise InputError(
                f"{self.name} is a vector, and a slice of it three pictures: slice one component, "
                "or norm(...) of it"
            )
        axes: Any = new_figure().add_subplot() if ax is None else ax
        shown = axes.imshow(
            self.values,
            origin="lower",
            extent=self.extent,
            cmap=get_colormap(colormap),
            norm=_norm(self.values, norm, *self._limits(vmin, vmax)),
            interpolation="nearest",
        )
        axes.set(xlabel=self._label(self.plane.right), ylabel=self._label(self.plane.up))
        add_color_bar(axes, shown, _with_unit(self.name, self.unit), own=ax is None)
        drawn: Axes = axes
        return drawn

    def _limits(self, *limits: Any) -> list[float | None]:
        pairs = zip(("vmin", "vmax"), limits, strict=True)
        unit = self.unit or None
        return [None if v is None else float(plain(v, unit, what)) for what, v in pairs]

    def _repr_png_(self) -> bytes | None:
        return values_png([self.values]) if self.values.ndim == 2 else None

    def _repr_html_(self) -> str:
        data = self._repr_png_()
        return page("Slice", picture(data, repr(self)) if data else repr(self))

    def __repr__(self) -> str:
        ny, nx = self.values.shape[-2:]
        finite = self.values[np.isfinite(self.values)]
        span = f"{finite.min():.4g} … {finite.max():.4g}" if finite.size else "nothing"
        left, right, bottom, top = self.extent
        size = f"{right - left:.4g}×{top - bottom:.4g} {self.length_unit}".rstrip()
        what = f"{self.name}: {span} {self.unit}".rstrip()
        return f"<Slice {nx}×{ny} pixels, {size}, {what}>"

    def _label(self, direction: np.ndarray) -> str:
        along = np.flatnonzero(direction >= _ALONG)
        rounded = ", ".join(f"{part:.2g}" for part in direction)
        return _with_unit("xyz"[along[0]] if along.size else f"({rounded})", self.length_unit)


immutable(Slice, "make another by volume.slice(...); `values` are in its `unit`")


def slice_of(volume: Any, expression: Any, plane: Plane, camera: Camera) -> Slice:
    """Return an expression on a plane; three components of a vector."""
    volume = volume if camera is None else volume.seen_by(camera)
    parts = tuple(volume.without_units(part) for part in components(expression))
    volume.refresh()
    cells = cells_on(volume.grid, plane)
    inside, grid = cells >= 0, volume.grid
    shown = np.full((len(parts), *cells.shape), np.nan)
    for values, part in zip(shown, parts, strict=True):
        values[inside] = _in_cells(volume, part, cells[inside])
    is_vector = len(parts) > 1
    unit = None if is_vector else volume.expression_unit(Expression(expression))
    name = expression.text if isinstance(expression, Expression) else str(expression)
    unit, length = unit_name(unit), unit_name(grid.unit)
    return Slice(shown if is_vector else shown[0], plane.extent, unit, length, plane, name)


def _in_cells(volume: Any, expression: Expression, cells: np.ndarray) -> np.ndarray:
    """Return an expression in some cells, given by flat numbers: the others are not computed.

    A slice of 512³ cells took 0.6 s for one field, of all cells; it takes 40 ms.
    """
    if any(name not in volume.fields for name in expression.names):
        values: np.ndarray = volume.evaluate(expression).reshape(-1)[cells]
        return values
    fields = {name: _field_in(volume, name, cells) for name in expression.names}
    return np.broadcast_to(expression.evaluate(NumpyOps(), fields), cells.shape)


def _field_in(volume: Any, name: str, cells: np.ndarray) -> np.ndarray:
    """Return a field in some cells; of one that waits in a file the box around them is read."""
    shape = volume.grid.shape
    if name in volume.waiting and len(shape) == 3:
        index = np.unravel_index(cells, shape)
        low, high = [int(i.min()) for i in index], [int(i.max()) + 1 for i in index]
        box: np.ndarray = volume.store.read(name, low, high)
        return box[tuple(i - a for i, a in zip(index, low, strict=True))]
    field: np.ndarray = volume.array(name).reshape(-1)[cells]
    return field


def _norm(values: np.ndarray, norm: Any, vmin: float | None, vmax: float | None) -> Any:
    from matplotlib.colors import LogNorm, Normalize

    if isinstance(norm, Normalize):
        if vmin is not None or vmax is not None:
            raise InputError("vmin and vmax belong inside the norm that was given")
        return norm
    if norm not in (None, "linear", "log"):
        raise InputError(f"norm must be 'linear', 'log' or a matplotlib Normalize, got {norm!r}")
    if norm != "log":
        return Normalize(vmin, vmax)
    if vmin is None and not np.any(values > 0):
        raise InputError("norm='log' needs positive values, and there are none in this slice")
    return LogNorm(vmin, vmax)


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_VECTOR = "three finite numbers"
# What is counted, pixels and points, is less than this.
MOST = 1 << 31
# Per pixel, while its cell is looked for: places in space, in the grid, in whole numbers.
_PIXEL_BYTES = 210
# What is to the right and up in a slice across an axis: the next axes in turn.
_FRAMES = {"x": ("y", "z"), "y": ("z", "x"), "z": ("x", "y")}


@dataclass(frozen=True)
class Plane:
    """A rectangle in space, with pixels.

    Attributes
    ----------
    center, right, up : arrays, shape (3,)
        Its middle, and unit vectors along its sides.
    width : (float, float)
    pixels : (int, int)
    """

    center: np.ndarray
    right: np.ndarray
    up: np.ndarray
    width: tuple[float, float]
    pixels: tuple[int, int]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Coordinates of the sides along `right` and `up`: left, right, bottom, top."""
        u, v = float(self.center @ self.right), float(self.center @ self.up)
        w, h = self.width
        return u - 0.5 * w, u + 0.5 * w, v - 0.5 * h, v + 0.5 * h

    def points(self) -> np.ndarray:
        """Return the middles of the pixels, shape (ny * nx, 3), row 0 at the bottom."""
        steps = [
            ((np.arange(n) + 0.5) / n - 0.5) * w
            for n, w in zip(self.pixels, self.width, strict=True)
        ]
        u, v = (step[:, None] for step in steps)
        rows, columns = v * self.up, self.center + u * self.right
        return np.asarray(columns + rows[:, None]).reshape(-1, 3)


def make_plane(
    grid: Grid, normal: Any, position: Any, width: Any, center: Any, up: Any, resolution: Any
) -> Plane:
    """Return a plane through a grid; see `Volume.slice`."""
    towards, right, upwards = _frame(normal, up)
    middle = grid.bounds.mean(axis=1)
    if center is not None:
        middle = _three(center, grid.unit, "center")
    if position is not None:
        level = _finite(position, grid.unit, "position")
        middle = middle + (level - middle @ towards) * towards
    size = _size(grid, width, middle, right, upwards)
    return Plane(middle, right, upwards, size, _pixels(resolution, size))


def cells_on(grid: Grid, plane: Plane) -> np.ndarray:
    """Return the flat numbers of the cells at a plane's pixels, shape (ny, nx); -1 outside."""
    nx, ny = plane.pixels
    check_memory(
        _PIXEL_BYTES * nx * ny, f"a slice of {nx} x {ny} pixels", "take fewer, resolution=400"
    )
    points = plane.points()
    cells = np.asarray(grid.locate(points)).reshape(ny, nx)
    if cells.max() < 0:
        low, high = grid.bounds.T
        inside = np.all((points >= low) & (points <= high), axis=1).any()
        why = "where the slice is the grid has a gap" if inside else "the slice is outside of it"
        raise InputError(
            f"no pixel of the slice is in a cell; the volume is in {_told(grid)}: {why}; give "
            "another position= or center="
        )
    return cells


def _told(grid: Grid) -> str:
    spans = zip("xyz", grid.bounds, strict=True)
    listed = ", ".join(f"{axis}: {low:g} … {high:g}" for axis, (low, high) in spans)
    return f"{listed} {unit_name(grid.unit)}".rstrip()


def _frame(normal: Any, up: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if isinstance(normal, str):
        if normal not in AXES:
            raise unknown_name("axis", normal, AXES)
        if up is None:
            return _along(normal), _along(_FRAMES[normal][0]), _along(_FRAMES[normal][1])
        normal = AXES[normal]
    towards = _unit(normal, "normal", f"'x', 'y', 'z' or {_VECTOR}")
    if up is None:
        up = AXES["z"] if abs(towards[2]) < 1 - 1e-9 else AXES["y"]
    sideways = np.cross(_unit(up, "up"), towards)
    if np.linalg.norm(sideways) < 1e-9:
        raise InputError(f"up must not be parallel to the normal, got {up!r}")
    sideways /= np.linalg.norm(sideways)
    return towards, sideways, np.cross(towards, sideways)


def _along(axis: str) -> np.ndarray:
    return np.array(AXES[axis])


def _size(
    grid: Grid, width: Any, middle: np.ndarray, right: np.ndarray, up: np.ndarray
) -> tuple[float, float]:
    if width is None:
        corners = np.array(np.meshgrid(*grid.bounds, indexing="ij")).reshape(3, -1).T - middle
        return 2 * float(np.abs(corners @ right).max()), 2 * float(np.abs(corners @ up).max())
    size = np.asarray(plain(width, grid.unit, "width"))
    size = np.where(size < 1e300, size, np.inf)
    if size.shape not in ((), (2,)) or not np.all(np.isfinite(size)) or size.min() <= 0:
        raise InputError(f"width must be a positive number or a pair of them, got {width!r}")
    w, h = np.broadcast_to(size, (2,)).tolist()
    return w, h


def _pixels(resolution: Any, size: tuple[float, float]) -> tuple[int, int]:
    """Return (nx, ny): a pair as it is, a number for the longer side, with square pixels."""
    pair = resolution if isinstance(resolution, (list, tuple)) else np.atleast_1d(resolution)
    if len(pair) not in (1, 2) or not all(is_count(n, MOST) for n in pair):
        raise InputError(
            f"resolution must be a positive whole number or a pair, got {shown(resolution)}"
        )
    if len(pair) == 2:
        return int(pair[0]), int(pair[1])
    longest = max(size)
    nx, ny = (max(1, round(int(pair[0]) * w / longest)) for w in size)
    return nx, ny


def _finite(value: Any, unit: Unit, what: str) -> float:
    number = None if value is None else plain(value, unit, what)
    if not isinstance(number, float) or not np.isfinite(number):
        raise InputError(f"{what} must be a finite number, got {shown(value)}")
    return number


def _three(value: Any, unit: Unit, what: str, expected: str = _VECTOR) -> np.ndarray:
    array = np.asarray(plain(value, unit, what), dtype=np.float64)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be {expected}, got {value!r}")
    return array


def _unit(value: Any, what: str, expected: str = _VECTOR) -> np.ndarray:
    vector = _three(value, None, what, expected)
    if not np.any(vector):
        raise InputError(f"{what} must not be zero")
    return np.asarray(vector / np.linalg.norm(vector))


# Pixels of a thumbnail, and white ones between two.
THUMBNAIL_PIXELS, _GAP = 96, 4
# Positive values that are not whole are shown as logarithms if their range is wider than this; all
# but the faintest percent.
_WIDE, _FAINT = 100.0, 2.0


def values_png(slices: list[np.ndarray]) -> bytes:
    """Return pictures of values beside each other; logarithmic if they are wide."""
    every = np.concatenate([values[np.isfinite(values)] for values in slices])
    low, high = (float(every.min()), float(every.max())) if every.size else (0.0, 1.0)
    if low >= 0.0 and np.any(every % 1):
        least = float(np.percentile(every[every > 0.0], _FAINT))
        if high > _WIDE * least:
            slices = [np.log10(np.maximum(values, least)) for values in slices]
            low, high = np.log10(least), np.log10(high)
    colormap = get_colormap("viridis").with_extremes(bad=(0.9, 0.9, 0.9))
    height = max(len(values) for values in slices)
    columns: list[np.ndarray] = []
    for values in slices:
        scaled = np.ma.masked_invalid((values - low) / ((high - low) or 1.0))
        above = np.ones((height - len(values), values.shape[1], 4))
        columns += [np.concatenate([colormap(scaled), above]), np.ones((height, _GAP, 4))]
    page = np.concatenate(columns[:-1], axis=1)
    zoom = max(1, 2 * THUMBNAIL_PIXELS // height)
    return png(np.repeat(np.repeat(page, zoom, axis=0), zoom, axis=1))


_MOST_FIELDS = 40
# Of fields with more values than that, so many are looked at.
_ALL, _VALUES = 1 << 22, 1 << 17
_FIRST = ("density", "gas_density", "rho", "dens")
_HEAD = ("field", "unit", "least", "greatest", "NaN")


def volume_html(volume: Any) -> str:
    """Return grid, fields and slices as HTML; what waits in a file is not read for it."""
    rows = [_row(volume, name) for name in list(volume)[:_MOST_FIELDS]]
    more = "" if len(volume) <= _MOST_FIELDS else f"and {len(volume) - _MOST_FIELDS} more"
    name = shown_field(volume)
    slices = ""
    if name is not None:
        slices = picture(slices_png(volume, name), f"{name}, across x, y and z")
    return page(f"Volume on {volume.grid!r}", slices, table(rows, _HEAD), more)


def shown_field(volume: Any) -> str | None:
    """Return the field whose slices are shown: a density, or the first that has been read."""
    ready = [name for name in volume if name not in volume.waiting]
    return next((name for name in (*_FIRST, *ready) if name in ready), None)


def _row(volume: Any, name: str) -> tuple[str, ...]:
    unit = volume.units[name]
    if name in volume.waiting:
        return name, unit, "not read yet", "", ""
    array = volume.array(name).reshape(-1)
    step = 1 if array.size <= _ALL else array.size // _VALUES | 1  # of no usual side a part
    values = array[::step]
    lacking = np.isnan(values) if values.dtype.kind == "f" else np.zeros(values.shape, bool)
    about = "≈ " if step > 1 else ""
    part = f"{about}{100 * lacking.mean():.3g} %" if lacking.any() else f"{about}0 %"
    if lacking.all():
        return name, unit, "", "", part
    good = values[~lacking]
    return name, unit, f"{about}{good.min():.4g}", f"{about}{good.max():.4g}", part


def slices_png(volume: Any, name: str) -> bytes:
    """Return slices through the middle of a field, across x, y and z, beside each other."""
    values = volume.array(name).reshape(-1)
    slices = []
    for axis in "xyz":
        plane = make_plane(volume.grid, axis, None, None, None, None, THUMBNAIL_PIXELS)
        try:
            cells = cells_on(volume.grid, plane)
        except ValueError:  # a gap of the grid is there
            cells = np.full(plane.pixels[::-1], -1)
        slices.append(np.where(cells >= 0, values[cells].astype(np.float64), np.nan))
    return values_png(slices)
