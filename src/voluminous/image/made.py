"""What is made of an image: an annotated picture, a map on the sky, in another unit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from astropy.io.fits import PrimaryHDU

    from .image import Image


class Made:
    """Methods of `Image`."""

    def to_hdu(
        self: Any, *, distance: Any = None, position: Any = None, position_angle: Any = 0.0
    ) -> PrimaryHDU:
        """Return the intensities as an astropy HDU with units, world coordinates and the camera.

        Parameters
        ----------
        distance, position, position_angle : optional
            As in `on_sky`: celestial coordinates. Without them those that the image has, or its
            plane's, linear and in its unit (always there, as WCS "A" beside celestial ones).

        Returns
        -------
        astropy.io.fits.PrimaryHDU
            Of (ny, nx), or (channel, ny, nx) for several channels. ``image.save("x.fits")`` writes
            it, and all else that is known.
        """
        from .hdu import to_hdu

        return to_hdu(self, distance, position, position_angle)

    def on_sky(
        self: Any, *, distance: Any = None, position: Any, position_angle: Any = 0.0
    ) -> Image:
        """Return the image with celestial world coordinates: what is where on the sky.

        Parameters
        ----------
        distance : Quantity, str or float
            Of the object, e.g. ``140 * u.pc``; plain numbers are in the image's unit. Not for
            perspective cameras, whose pictures are measured in angles.
        position : SkyCoord, (ra, dec) or str
            Of the plane's origin, where x = y = 0; plain numbers are degrees (ICRS).
        position_angle : float or Quantity
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

        return on_sky(self, distance, position, position_angle)

    def convolve(self: Any, beam: Any) -> Image:
        """Return the image as seen with a telescope's beam, an elliptical Gaussian.

        Parameters
        ----------
        beam : float, Quantity, tuple or radio_beam.Beam
            Full width at half maximum; or (major, minor), or (major, minor, position angle).
            Lengths in the image's plane, or angles if it is on the sky; plain numbers are in its
            unit. The angle runs from north to east (from up to the left).

        Returns
        -------
        Image
            Of the same unit, with sums kept but for what is spread over the edges. The optical
            depth is left out: a mean over a beam has none. Missing pixels (NaN) are filled from
            around them, as far as the beam reaches.

        Raises
        ------
        InputError
            For maps whose numbers do not add up, such as depths.
        UnitsError
            If the beam's unit is not the plane's.
        """
        from .beam import convolve

        return convolve(self, beam)

    def to(self: Any, unit: Any, *, beam: Any = None) -> Image:
        """Return the image in another unit: of its plane (`unit`), or of its intensities.

        Parameters
        ----------
        unit : str or unit
            A length (or an angle, if the plane has angles) converts `x`, `y` and `pixel_size`; any
            other, such as ``"Jy/beam"``, ``"Jy/pix"`` or ``"MJy/sr"``, intensities, errors and
            bounds. Maps whose values are lengths too (depths) have both converted.
        beam : optional
            As in `convolve`, for units per beam. Default: the one the image was convolved with.

        Returns
        -------
        Image
            In double precision if numbers of the new unit are beyond single precision.

        Raises
        ------
        UnitsError
            If the image has no such unit, it cannot be converted, or a solid angle is not known.
        """
        from .conversion import to_unit

        return to_unit(self, unit, beam)

    def annotate(self: Any, **options: Any) -> Any:
        """Return the picture with a scale bar, axes, colour bars …, its own pixels unchanged.

        Annotations that the image knows nothing for are left out. What stands in the picture takes
        the ink that can be read there; letters grow with the picture.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Draw into these, with lines and letters of matplotlib's sizes, and return them.
        unit : str or unit, optional
            Show the image so, as `to` converts it. Default: units that suit its size; with `ticks`
            the scale bar has the unit of the axes.
        scale_bar : bool, Quantity, str or float
            A bar of 1, 2 or 5 · 10ⁿ of a unit that suits its length; or of this length, such as
            ``"100 au"``. Perspective pictures wider than 0.2 radians have no one scale, and get
            none by themselves.
        triad : bool
            The x, y and z axes of the volume as the camera sees them, at the lower right.
        compass : bool
            North and east at the upper right, of an image with celestial coordinates (`on_sky`).
        ticks : bool
            Axes with ticks around the picture. Default: False.
        color_bar : bool
            Beside the picture: the intensities of a picture that shows one channel; or the colours
            of the medium, each as bright as can be.
        title : str
            Above the picture, no wider than it.
        time : bool, str, float or Quantity
            Time stamp at the upper left. True: what ``volume.meta`` tells as ``"time"`` (in
            ``"time_unit"``) and ``"redshift"``.
        volume : Volume, optional
            For the time, and the histogram of its cells beside each colour bar (logarithmic).
        medium : Medium, optional
            Default: what the image's provenance tells of it.
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
