"""`Image`, the result of a render: intensities with coordinates, units and provenance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import check_name, immutable
from . import arguments, tone
from .arguments import Array, json_value

if TYPE_CHECKING:
    from astropy.io.fits import PrimaryHDU
    from astropy.wcs import WCS
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize

    from ..units import UnitLike

Own = TypeVar("Own", bound="Image")


class Image:
    """A picture: intensity per pixel and channel, with coordinates, units and provenance.

    Parameters
    ----------
    intensity : array_like or Quantity, shape (ny, nx, channel) or (ny, nx)
        Row 0 is at the bottom, x runs to the right. float32 and float64 stay as they are,
        integers become float64.
    transparency : array_like, optional
        exp(-optical depth) along each ray. Broadcastable to (ny, nx, channel); two axes mean
        (ny, nx), the same for every channel.
    optical_depth : array_like or callable, optional
        Likewise; or a function without arguments that gives it, called once, on first use.
    error : array_like, shape (ny, nx), optional
        Estimated absolute error of the intensity: the largest of all channels for the colours of a
        picture; for a spectrum that of the brightest channel, and the same fraction of the maximum
        in every other one.
    lower, upper : array_like, shape (ny, nx, channel), optional
        Guaranteed bounds of the intensity.
    x, y : array_like or Quantity, shapes (nx,) and (ny,), optional
        Coordinates of the pixel centres on the image plane. Default: pixel indices.
    unit : str or unit, optional
        Unit of `x` and `y`: a length, ``"rad"`` for angles, ``""`` for dimensionless.
    intensity_unit : str or unit, optional
        Unit of `intensity`.
    pixel_size : (float, float) or Quantity, optional
        Width and height of a pixel in `unit`. Follows from `x` and `y`, unless there is but one
        column or row; then pixels are taken as square if it is not given.
    wcs : astropy.wcs.WCS, optional
        World coordinates of the pixels (the lower left one is 0, 0), of two axes: right ascension
        and declination, or an offset and a velocity. `plot` shows them, and all formats keep them.
    distance : Quantity, str or float, optional
        Distance of the object, if `unit` is a length: pixels then have a solid angle. Plain numbers
        are cm.
    camera : dict, optional
        Description of the camera (type, angles, …).
    provenance : dict, optional
        Origin of the image (scene, versions, …). Both are saved with the image in every format, so
        they hold dicts, lists, strings, numbers, booleans and None only.

    Raises
    ------
    InputError
        If shapes do not fit, or something cannot be saved.
    UnitsError
        If a quantity cannot be converted to the unit that is given.

    Examples
    --------
    >>> Image([[0.0, 0.5], [1.0, 2.0]], unit="pc")
    <Image 2×2 pixels, 1 channel, 2×2 pc, intensity 0 … 2>
    """

    intensity: Array
    intensity_unit: str
    unit: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    _pending: Callable[[], ArrayLike] | None
    _planes: dict[str, Array | None]
    pixel_size: tuple[float, float]
    wcs: WCS | None
    distance: float | None
    camera: dict[str, Any] | None
    provenance: dict[str, Any] | None
    # NumPy's functions would operate on display values instead of intensities.
    __array_ufunc__ = None

    def __init__(
        self,
        intensity: ArrayLike,
        *,
        transparency: ArrayLike | None = None,
        optical_depth: ArrayLike | Callable[[], ArrayLike] | None = None,
        error: ArrayLike | None = None,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        x: ArrayLike | None = None,
        y: ArrayLike | None = None,
        unit: UnitLike = "",
        intensity_unit: UnitLike = "",
        pixel_size: Any = None,
        wcs: WCS | None = None,
        distance: Any = None,
        camera: dict[str, Any] | None = None,
        provenance: dict[str, Any] | None = None,
    ) -> None:
        values, intensity_unit = arguments.intensity(intensity, intensity_unit)
        ny, nx, _ = shape = values.shape
        name = arguments.length_unit(unit, x, y)
        x, y = arguments.axis(x, nx, name, "x"), arguments.axis(y, ny, name, "y")
        pending = optical_depth if callable(optical_depth) else None
        beside = {
            "transparency": transparency,
            "optical_depth": None if pending else optical_depth,
            "error": error,
            "lower": lower,
            "upper": upper,
        }
        vars(self).update(
            intensity=_read_only(values),
            intensity_unit=intensity_unit,
            _planes={name: arguments.plane(p, shape, name) for name, p in beside.items()},
            _pending=pending,
            unit=name,
            x=_read_only(x),
            y=_read_only(y),
            pixel_size=arguments.pixel_size(x, y, pixel_size, name),
            wcs=arguments.as_wcs(wcs, shape),
            distance=arguments.distance(distance),
            camera=json_value(camera, "camera"),
            provenance=json_value(provenance, "provenance"),
        )

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for copies and pickles; a deferred optical depth is computed first."""
        _ = self.optical_depth
        return dict(vars(self))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, columns and channels."""
        ny, nx, count = self.intensity.shape
        return ny, nx, count

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.shape[2]

    @property
    def transparency(self) -> Array | None:
        """Transmitted fraction of the light from behind, (ny, nx, channel); None if unknown."""
        return _spread(self._planes["transparency"], self.shape)

    @property
    def optical_depth(self) -> Array | None:
        """Optical depth along each ray, (ny, nx, channel); None if unknown."""
        if self._pending is not None:
            depth = arguments.plane(self._pending(), self.shape, "optical_depth")
            self._planes["optical_depth"] = depth
            vars(self)["_pending"] = None
        return _spread(self._planes["optical_depth"], self.shape)

    @property
    def waits_for_depth(self) -> bool:
        """True while the optical depth is deferred, because it needs another render."""
        return self._pending is not None

    @property
    def error(self) -> Array | None:
        """Estimated error of the intensity, largest of all channels, (ny, nx); None if unknown."""
        array = self._planes["error"]
        return None if array is None else array[..., 0]

    @property
    def lower(self) -> Array | None:
        """Guaranteed lower bound of the intensity, (ny, nx, channel); None if not requested."""
        return _spread(self._planes["lower"], self.shape)

    @property
    def upper(self) -> Array | None:
        """Guaranteed upper bound of the intensity, (ny, nx, channel); None if not requested."""
        return _spread(self._planes["upper"], self.shape)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Outer edges of the picture (left, right, bottom, top), as matplotlib's imshow takes."""
        width, height = (0.5 * side for side in self.pixel_size)
        left, right = self.x[0] - width, self.x[-1] + width
        return float(left), float(right), float(self.y[0] - height), float(self.y[-1] + height)

    @property
    def pixel_area(self) -> float:
        """Area of a pixel, in `unit` squared."""
        return abs(self.pixel_size[0] * self.pixel_size[1])

    @property
    def exposure(self) -> float:
        """The automatic exposure of all channels, which ``to_rgb(exposure=…)`` reproduces.

        Pass it to other frames (`to_rgb`, `save`, `plot`, …) to show equal intensities alike.
        """
        return tone.exposure_of(self.intensity)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the picture: display values of `to_rgb`, (ny, nx, 3), with its top row first.

        So ``plt.imshow(image)`` shows it upright. For the intensities use `intensity`.
        """
        if copy is False:
            raise ValueError("the display values of an Image are made anew: copy=False is no way")
        return self.to_rgb()[::-1].astype(dtype or np.float32)

    def to_rgb(
        self,
        exposure: float | str | None = None,
        stretch: str | float = "linear",
        gamut: str = "hue",
        *,
        channels: int | Sequence[int] | None = None,
        mix: ArrayLike | None = None,
        colormap: Any = None,
        norm: str | Normalize | None = None,
        vmin: float | None = None,
        vmax: float | None = None,
        background: Any = None,
        softening: float | None = None,
    ) -> NDArray[np.float32]:
        """Return display values, shape (ny, nx, 3), from 0 to 1, row 0 at the bottom.

        Display the values unchanged, as every PNG viewer and matplotlib do: with
        the default `stretch` an intensity of 0.5 / exposure is half of full scale.

        Parameters
        ----------
        exposure : float or "rgb", optional
            Factor for the intensities; an intensity of 1 / exposure is shown as white.
            Default: 1 / w, where 99.9 % of the pixels that are not black stay below w in their
            brightest colour; `Image.exposure` is this number, for the frames of a movie. "rgb"
            takes intensities as red, green and blue from 0 to 1 and shows them as they are, each
            limited to 1, as in Peters (2014): ``exposure=1, gamut="clip"``.
        stretch : {"linear", "sqrt", "asinh", "log", "gamma"} or float
            Curve between black (0) and white (1), which brightens faint regions. A number g means
            v**(1/g); "gamma" is 2.2; "asinh" and "log" are linear far below `softening` and
            logarithmic far above.
        gamut : {"hue", "clip"}
            "hue" applies the stretch and the limit to the brightest of the three colours and
            scales the other two by the same factor, so that hues never shift; "clip" treats each
            colour separately, so that overexposed regions turn white.
        channels : int or sequence of int, optional
            Channels to show, e.g. ``(2, 1, 0)``; a single channel is grey. Default: all.
        mix : array_like, shape (shown channels, 3), optional
            Red, green and blue of each shown channel. Default: grey for one; orange and blue for
            two; red, green, blue for three, and every further one (such as a star's) white.
        colormap : str or matplotlib colormap, optional
            Show one channel through this colormap instead. Values run from `vmin` (default: the
            minimum) to `vmax` (default: the maximum, or 1 / exposure), mapped by `stretch`.
        norm : {"linear", "log"} or matplotlib Normalize, optional
            Replaces `stretch`, for one channel; grey without a `colormap`. "log" starts at the
            smallest positive value, but at most six decades below `vmax`.
        vmin, vmax : float or Quantity, optional
            Intensities shown as black (default: 0) and as white (1 / `exposure`).
            Plain numbers are in `intensity_unit`.
        background : color, optional
            Colour behind the picture, seen through its transparency. For images rendered with a
            black background.
        softening : float, optional
            For "asinh" (default 0.1) and "log" (0.01), in units of white.

        Raises
        ------
        InputError
            If options contradict each other or do not fit the image.
        UnknownNameError
            If a stretch, gamut or colormap does not exist.
        UnitsError
            If a quantity cannot be converted to `intensity_unit`.

        Notes
        -----
        NaN and negative pixels are black (with a colormap: its "bad" colour and its lowest
        colour), infinite pixels have full brightness. An image of zeros is black. One channel
        of both signs, such as a map of velocities, is shown from blue through white (zero) to
        red, unless an option chooses otherwise.
        """
        options = {name: value for name, value in locals().items() if name in tone.OPTIONS}
        shown = tone.with_colormap(self, options)
        return tone.display(self.intensity, self.transparency, shown)

    def save(self, path: str | Path, **options: Any) -> None:
        """Write the image to a file; its suffix chooses the format.

        The file is written atomically: an error or an interruption leaves an existing file
        unchanged.

        Parameters
        ----------
        path : str or Path
            ``.png`` holds display values; ``.tif``, ``.exr`` the intensities rounded to float32;
            ``.fits``, ``.npz`` everything unchanged. All hold coordinates, units, camera and
            provenance. ``.jpg``, ``.pdf`` and ``.svg`` hold the display values only.
        **options
            PNG: all of `to_rgb`, ``bits=16``, ``transparent=True`` (alpha from the transparency),
            and ``annotate``: True, or options of `annotate`. JPEG, PDF, SVG: the same without bits;
            JPEG: ``quality=95`` in place of ``transparent``. EXR: ``half=True`` (16-bit floats).
            FITS: ``distance``, ``position`` and ``posang`` of `on_sky`.

        Raises
        ------
        UnknownNameError
            If there is no such format or option; names the nearest.
        MissingPathError
            If the directory does not exist.
        """
        from ..files import as_path
        from .formats import save

        save(self, as_path(path), **options)

    @classmethod
    def load(cls, path: str | Path) -> Image:
        """Read an image written by `save` or by another program.

        NPZ and FITS restore everything bit for bit, TIFF and EXR the intensities in float32
        (EXR also optical depth and transparency). A file whose channels have wavelengths,
        frequencies or velocities gives a `Cube`. A PNG gives its display values, from 0 to 1;
        with 16 bits per colour it needs the package imagecodecs (``voluminous[tiff]``, as TIFF
        does; ``voluminous[exr]`` is for EXR).

        Raises
        ------
        MissingPathError
            If there is no such file.
        FileFormatError
            If it is damaged, or its content does not match its suffix.
        """
        from ..files import as_path
        from .formats import load

        return load(as_path(path), cls)

    def plot(
        self,
        ax: Axes | None = None,
        *,
        unit: UnitLike = None,
        scale_bar: Any = False,
        colorbar: bool = True,
        **options: Any,
    ) -> Axes:
        """Draw the image with axes in its unit, and a colour bar.

        An image with world coordinates is drawn in these, unless `ax` is not a WCSAxes.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw. Default: a new figure, shown by notebooks and ``plt.show()`` if pyplot
            is in use; otherwise a figure without a window, for ``ax.figure.savefig(...)``.
        unit : str or unit, optional
            Convert the image first, as with `to`: axes to ``"pc"``, or values to ``"Jy/sr"``.
        scale_bar : bool, Quantity, str or float
            Add a bar: True for a round length in the same unit, or a length such as ``"100 au"``.
        colorbar : bool
            Add a colour bar: of the intensities if one channel is shown, else of the medium's
            colours, if `provenance` contains them.
        **options
            Those of `to_rgb`.

        Returns
        -------
        matplotlib Axes
        """
        shown = self if unit is None else self.to(unit)
        from .plot import plot as draw

        axes: Axes = draw(shown, ax, scale_bar=scale_bar, colorbar=colorbar, **options)
        return axes

    def to_hdu(
        self, *, distance: Any = None, position: Any = None, posang: Any = 0.0
    ) -> PrimaryHDU:
        """Return the intensities as an astropy HDU with units, world coordinates and the camera.

        Parameters
        ----------
        distance, position, posang : optional
            As in `on_sky`, for celestial coordinates. Default: the image's WCS, or else the linear
            coordinates of its plane in its unit (always present, as WCS "A" beside celestial ones).

        Returns
        -------
        astropy.io.fits.PrimaryHDU
            Shape (ny, nx), or (channel, ny, nx) for several channels. ``image.save("x.fits")``
            also writes the other arrays and metadata.
        """
        from .hdu import to_hdu

        return to_hdu(self, distance, position, posang)

    def on_sky(self: Own, *, distance: Any = None, position: Any, posang: Any = 0.0) -> Own:
        """Return the image with celestial world coordinates.

        Parameters
        ----------
        distance : Quantity, str or float
            Distance of the object, e.g. ``140 * u.pc``; plain numbers are in the image's unit.
            Default: that of the image. Not for perspective cameras, whose image coordinates are
            angles.
        position : SkyCoord, (ra, dec) or str
            Position of the plane's origin, x = y = 0; plain numbers are degrees (ICRS).
        posang : float or Quantity
            Angle of the picture's y axis from north towards east; plain numbers are degrees.

        Raises
        ------
        InputError, UnitsError
            If one is missing, or does not fit the image's unit.

        Notes
        -----
        East is on the left where north is up. A plane at a distance is a gnomonic projection (TAN)
        exactly; a dome is zenithal equidistant (ARC): Calabretta & Greisen (2002), A&A 395, 1077.
        """
        from .sky import on_sky

        return on_sky(self, distance, position, posang)

    def convolve(self: Own, beam: Any) -> Own:
        """Return the image convolved with a telescope's beam, an elliptical Gaussian.

        Parameters
        ----------
        beam : float, Quantity, tuple or radio_beam.Beam
            Full width at half maximum; or (major, minor), or (major, minor, position angle).
            Lengths in the image's plane, or angles if it is on the sky or has a `distance`; plain
            numbers are in its unit. The angle runs from north to east (from up to the left).

        Returns
        -------
        Image
            In the same unit. Sums are conserved, except for the loss over the edges. The optical
            depth is dropped: a mean over a beam has none. Missing pixels (NaN) are interpolated
            from their surroundings within the radius of the beam.

        Raises
        ------
        InputError
            For maps whose values are not additive, such as depths; if the beam is narrower than a
            pixel.
        UnitsError
            If the beam's unit is not the plane's.
        """
        from .conversion import convolve

        return convolve(self, beam)

    def to(self: Own, unit: UnitLike, *, beam: Any = None) -> Own:
        """Return the image with its plane (`unit`) or its intensities in another unit.

        Parameters
        ----------
        unit : str or unit
            A length or an angle converts `x`, `y` and `pixel_size`, from one to the other by
            `distance`; any other unit, such as ``"Jy/beam"``, ``"Jy/pix"`` or ``"MJy/sr"``,
            converts intensities, errors and bounds; of a `Cube` also to ``"K"``. For maps whose
            values are lengths (depths), a length converts both.
        beam : optional
            As in `convolve`, for units per beam. Default: the one the image was convolved with.

        Returns
        -------
        Image
            In double precision if values in the new unit exceed the range of single precision.

        Raises
        ------
        UnitsError
            If the image has no unit, the unit cannot be converted, or a solid angle is missing.
        """
        from .conversion import to_unit

        return to_unit(self, unit, beam)

    def anaglyph(self) -> Image:
        """Return a picture for glasses with a red left and a cyan right eye.

        For pictures of two eyes (``stereo`` of `Perspective`) with one channel, or three: red,
        green and blue. Red is the brightness that the left eye sees (weights of ITU-R BT.709),
        green and blue are what the right eye sees.

        Raises
        ------
        InputError
            If the camera has no ``stereo``, or there are other channels.
        """
        from .tone import anaglyph

        return anaglyph(self)

    def annotate(self, **options: Any) -> Any:
        """Return the picture with a scale bar, axes, colour bars …; its pixels stay unchanged.

        Annotations for which the image has no metadata are omitted. Annotations inside the picture
        are drawn in a colour that contrasts with it; letters scale with the picture.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Draw into these, with matplotlib's line widths and font sizes, and return them.
        unit : str or unit, optional
            Convert the image first, as with `to`. Default: units that suit its size; with `ticks`
            the scale bar has the unit of the axes.
        scale_bar : bool, Quantity, str or float
            True: a bar of length 1, 2 or 5 · 10ⁿ in a suitable unit. Or the length, such as
            ``"100 au"``. Perspective pictures wider than 0.2 radians have no uniform scale, and
            get no bar by default.
        triad : bool
            The projected x, y and z axes of the volume, at the lower right.
        compass : bool
            North and east at the upper right, for images with celestial coordinates (`on_sky`).
        letters : bool
            The patient's sides at the borders, R, L, A, P, S and I, of a picture of a volume that
            says how it lies (``volume.meta["orientation"]``).
        measures : list of (array_like, str)
            Lines, points of shape (n, 2) in the coordinates of the picture, and a text for each.
        ticks : bool
            Axes with ticks around the picture. Default: False.
        color_bar : bool
            Beside the picture: the intensities if one channel is shown; otherwise the colours of
            the medium, each at full brightness.
        title : str
            Title above the picture, shrunk to its width if necessary.
        time : bool, str, float or Quantity
            Time stamp at the upper left. True: ``volume.meta["time"]`` (in
            ``"time_unit"``) and ``"redshift"``.
        volume : Volume, optional
            Source of the time and of the (logarithmic) histogram beside each colour bar.
        medium : Medium, optional
            Default: the medium in the image's provenance.
        paper : color or "none"
            Colour of the margins; "none" is transparent. Default: `background`, else black; nothing
            for `transparent`.
        font_size : float
            Height of letters in pixels. Default: 2.6 % of the picture's side.
        transparent : bool
            As in `save`: alpha from the transparency.
        **options
            All of `to_rgb`.

        Returns
        -------
        Annotated or matplotlib Axes
            With `save` (PNG; PDF and SVG with sharp text), ``rgba`` and ``figure``.

        Raises
        ------
        UnknownNameError
            For an unknown option; names the nearest.
        """
        from .annotate import annotate

        return annotate(self, **options)

    def replace(self: Own, **changes: Any) -> Own:
        """Return a copy with some arguments of `Image` replaced.

        Arrays are shared. None drops an array other than the intensity.
        """
        same = {k: v for k, v in vars(self).items() if not k.startswith("_")}
        if self.waits_for_depth:  # computing it needs another render
            same["optical_depth"] = lambda: self.plane("optical_depth")
        for name in arguments.PLANES:
            if name not in same and name not in changes:
                same[name] = self.plane(name)
        return type(self)(**{**same, **changes})

    def plane(self, name: str) -> Array | None:
        """Return an array such as the transparency, with one channel if all channels are equal."""
        check_name("plane", name, ("intensity", *arguments.PLANES))
        values: Array | None = getattr(self, name)
        grey = values is not None and values.ndim == 3 and values.strides[-1] == 0
        return values[..., :1] if values is not None and grey else values

    def _repr_png_(self) -> bytes:
        from .formats.png import encode

        return encode(self)

    def __repr__(self) -> str:
        ny, nx, count = self.shape
        left, right, bottom, top = self.extent
        finite = np.isfinite(self.intensity)
        low = self.intensity.min(where=finite, initial=np.inf)
        high = self.intensity.max(where=finite, initial=-np.inf)
        span = f"{low:.4g} … {high:.4g}" if finite.any() else "not finite"
        return (
            f"<Image {nx}×{ny} pixels, {count} channel{'s' * (count > 1)}, "
            f"{abs(right - left):.4g}×{abs(top - bottom):.4g} {self.unit}".rstrip()
            + f", intensity {span} {self.intensity_unit}".rstrip()
            + ">"
        )


immutable(
    Image,
    "image.to(unit) converts it, image.plot(unit=) shows it so; Image(...) makes a new one",
)


def _read_only(values: Array) -> Array:
    view: Array = values.view()
    view.flags.writeable = False  # ``image.intensity *= 2`` changed it and then raised
    return view


def _spread(array: Array | None, shape: tuple[int, ...]) -> Array | None:
    return None if array is None else np.broadcast_to(array, shape)
