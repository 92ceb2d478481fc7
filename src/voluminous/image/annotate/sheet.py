"""Canvas for annotations: a transparent figure around a picture, in its pixel coordinates.

matplotlib draws only the annotations; these are then composited over the picture, so that pixels
without annotations stay exactly unchanged.
"""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import check_name
from ...files import as_path, replacing
from .. import metadata
from ..formats.png import encode_pixels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Text

    from ..image import Image

Pixels = NDArray[np.uint8]
# One matplotlib point is one pixel, so font sizes and line widths are in pixels.
_DPI = 72
# Line width of axes, and size of their numbers, in letter heights.
LINE, NUMBERS = 0.06, 0.85
# Width and alpha of the outlines around annotations inside the picture.
_RIM, _RIM_ALPHA = 0.22, 0.55
# Added so that rounding cannot lose a pixel.
_WHOLE = 1e-3
# Letter height in square roots of the picture's area, and its minimum in pixels.
_LETTERS, _LEAST = 0.026, 8.0
_LUMINANCE = (0.2126, 0.7152, 0.0722)
_LIGHT, _DARK = "#f4f4f4", "#101010"
SUFFIXES = (".png", ".pdf", ".svg")


class Sheet:
    """A figure with a picture (uint8, (ny, nx, 4), row 0 at the bottom) at a place in it.

    Margins are pixels at the left, right, bottom and top, `letters` the height of letters in
    pixels, `paper` the colour of the margins; None is transparent.
    """

    canvas: Any

    def __init__(
        self,
        pixels: Pixels,
        margins: tuple[int, ...],
        letters: float,
        paper: tuple[float, ...] | None,
    ) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.transforms import Affine2D

        self.pixels, self.em, self.paper = pixels, letters, paper
        self.height, self.width = pixels.shape[:2]
        left, right, bottom, top = margins
        self.size = wide, high = self.width + left + right, self.height + bottom + top
        # Where the picture is: left, right, bottom, top.
        self.box = (left, left + self.width, bottom, bottom + self.height)
        self.figure = Figure(((wide + _WHOLE) / _DPI, (high + _WHOLE) / _DPI), dpi=_DPI)
        self.figure.patch.set_alpha(0.0)
        self.home: Any = self.figure
        self.canvas = FigureCanvasAgg(self.figure)
        # From picture coordinates to the screen.
        self.transform: Any = Affine2D().translate(left, bottom)
        # Colour of annotations on the margins; transparent margins are assumed to be on white.
        self.ink = _DARK if paper is None or luminance(np.array(paper)) > 0.5 else _LIGHT

    @property
    def per_pixel(self) -> float:
        """Sheet units per pixel of the picture."""
        return float(self.width / self.pixels.shape[1])

    @property
    def pad(self) -> float:
        """Distance of annotations from the edges of the picture."""
        return 0.9 * self.em

    def inks(self, x: float, y: float, width: float, height: float) -> tuple[str, str]:
        """Return the line and outline colours that are legible on a part of the picture."""
        x, y, width, height = (v / self.per_pixel for v in (x, y, width, height))
        rows = slice(max(0, int(y)), max(1, math.ceil(y + height)))
        columns = slice(max(0, int(x)), max(1, math.ceil(x + width)))
        part = self.pixels[rows, columns] / 255.0
        behind = np.array(self.paper if self.paper is not None else (1.0, 1.0, 1.0))
        seen = part[..., :3] * part[..., 3:] + (1.0 - part[..., 3:]) * behind
        light = seen.size > 0 and float(np.median(luminance(seen))) > 0.5
        return (_DARK, _LIGHT) if light else (_LIGHT, _DARK)

    def rim(self, color: str) -> list[Any]:
        """Return path effects that outline lines against the background."""
        from matplotlib.patheffects import withStroke

        return [withStroke(linewidth=_RIM * self.em, foreground=color, alpha=_RIM_ALPHA)]

    def text(self, x: float, y: float, words: str, **look: Any) -> Text:
        """Write at a position in picture pixels."""
        given = {"fontsize": self.em, "color": self.ink, "transform": self.transform}
        text: Text = self.home.text(x, y, words, **given | look)
        return text

    def rimmed(self, x: float, y: float, words: str, inks: tuple[str, str], **look: Any) -> None:
        """Write outlined letters in the picture as two texts.

        With path effects on one text, matplotlib draws letters as paths and snaps their thin
        strokes to whole pixels: an E becomes an L.
        """
        from matplotlib.patheffects import Stroke

        ink, rim = inks
        effect: dict[str, Any] = {"linewidth": _RIM * self.em, "foreground": rim, "snap": False}
        below = self.text(x, y, words, color=rim, alpha=_RIM_ALPHA, **look)
        below.set_path_effects([Stroke(**effect)])
        self.text(x, y, words, color=ink, **look)

    def add(self, artist: Any) -> None:
        """Add a line or a patch in pixels of the picture."""
        artist.set_transform(self.transform)
        self.home.add_artist(artist)

    def axes(self, x: float, y: float, width: float, height: float, **kind: Any) -> Axes:
        """Return axes at a position in picture pixels, with matching letters and lines."""
        left, _, bottom, _ = self.box
        place = np.array([x + left, y + bottom, width, height]) / (self.size * 2)
        axes: Axes = self.figure.add_axes(tuple(place), **kind)
        axes.patch.set_alpha(0.0)
        for spine in axes.spines.values():
            spine.set_linewidth(LINE * self.em)
            spine.set_edgecolor(self.ink)
        self.style_ticks(axes)
        return axes

    def style_ticks(self, axes: Axes) -> None:
        """Give ticks and their numbers the colour and size of the sheet."""
        look: dict[str, Any] = {"colors": self.ink, "labelsize": NUMBERS * self.em}
        look |= {"width": LINE * self.em, "pad": 0.25 * self.em}
        axes.tick_params(which="both", length=0.35 * self.em, **look)
        axes.tick_params(which="minor", length=0.2 * self.em)

    def end(self, artist: Any) -> float:
        """Return the right edge of an artist, in picture pixels."""
        return float(artist.get_tightbbox(self.canvas.get_renderer()).x1) - self.box[0]

    def overhang(self) -> tuple[int, ...]:
        """Return the margins that all drawn annotations need."""
        drawn = self.figure.get_tightbbox(self.canvas.get_renderer())
        left, right, bottom, top = self.box
        x0, y0, x1, y1 = (v * _DPI for v in (drawn.x0, drawn.y0, drawn.x1, drawn.y1))
        beyond = (left - x0, x1 - right, bottom - y0, y1 - top)
        return tuple(math.ceil(b + 0.6 * self.em) if b > 0.5 else 0 for b in beyond)

    def pixels_drawn(self) -> Pixels:
        """Return the whole sheet, shape (height, width, 4), row 0 at the bottom."""
        base = np.zeros((self.size[1], self.size[0], 4), dtype=np.uint8)
        if self.paper is not None:
            base[...] = [*np.rint(np.array(self.paper) * 255), 255]
        left, right, bottom, top = self.box
        place = base[bottom:top, left:right]
        place[...] = over(self.pixels, place)
        self.canvas.draw()
        return over(np.asarray(self.canvas.buffer_rgba())[::-1], base)


class AxesSheet(Sheet):
    """The part of a figure inside axes that show a picture, in points, as are `letters`."""

    def __init__(self, axes: Axes, pixels: Pixels, letters: float | None) -> None:
        import matplotlib
        from matplotlib.transforms import Affine2D

        figure: Any = axes.get_figure()
        # Fix the layout now; later layout changes move positions but do not resize letters.
        figure.draw_without_rendering()
        size = axes.get_window_extent()
        self.pixels, self.paper, self.ink = pixels, None, _LIGHT
        self.em = letters or float(matplotlib.rcParams["font.size"])
        self.width, self.height = (v * _DPI / figure.dpi for v in (size.width, size.height))
        self.home, self.figure, self.canvas = axes, figure, figure.canvas
        scale = Affine2D().scale(1.0 / self.width, 1.0 / self.height)
        self.transform = scale + axes.transAxes


def letter_height(pixels: Pixels) -> float:
    """Return the letter height for a picture, proportional to its size."""
    return max(_LEAST, _LETTERS * math.sqrt(pixels.shape[0] * pixels.shape[1]))


def luminance(colors: NDArray[np.float64]) -> Any:
    """Return the luminance of colours, from 0 to 1, ignoring gamma."""
    return colors @ np.array(_LUMINANCE)


def over(front: Pixels, behind: Pixels) -> Pixels:
    """Return one picture over another (straight alpha), bit-identical where `front` is transparent.

    Porter & Duff (1984), "Compositing digital images", for straight alpha.
    """
    mixed = front[..., 3] > 0
    result: Pixels = behind.copy()
    f, b = front[mixed] / 255.0, behind[mixed] / 255.0
    part = b[:, 3:] * (1.0 - f[:, 3:])
    alpha = f[:, 3:] + part
    colors = (f[:, :3] * f[:, 3:] + b[:, :3] * part) / alpha
    result[mixed] = np.rint(np.concatenate([colors, alpha], axis=1) * 255.0).astype(np.uint8)
    return result


class Annotated:
    """An annotated picture, the result of `Image.annotate`.

    Attributes
    ----------
    rgba : uint8 array (ny, nx, 4)
        Red, green, blue and alpha (straight) of the whole sheet; row 0 is at the bottom.
    box : (int, int, int, int)
        Position of the picture in it: left, right, bottom, top, in pixels.
    figure : matplotlib Figure
        The annotations alone, 72 dots per inch; one pixel is one point.
    image : Image
        The annotated image.
    """

    def __init__(self, image: Image, sheet: Sheet) -> None:
        self.image, self._sheet = image, sheet
        self.rgba = sheet.pixels_drawn()
        self.box, self.figure = sheet.box, sheet.figure

    @property
    def picture(self) -> Pixels:
        """The part of `rgba` with the picture, including annotations inside it."""
        left, right, bottom, top = self.box
        inside: Pixels = self.rgba[bottom:top, left:right]
        return inside

    def png(self) -> bytes:
        """Return a PNG file that contains the image's metadata."""
        opaque = (self.rgba[..., 3] == 255).all()
        pixels = np.ascontiguousarray(self.rgba[::-1, :, : 3 if opaque else 4])
        return encode_pixels(pixels, metadata.texts(self.image))

    def save(self, path: str | Path) -> None:
        """Write a file: ``.png``, or ``.pdf`` and ``.svg`` with sharp text in any size.

        Raises
        ------
        UnknownNameError
            If its suffix is another.
        MissingPathError
            If the directory does not exist.
        """
        path = as_path(path)
        suffix = path.suffix.lower()
        check_name("format of annotated pictures", suffix, SUFFIXES)
        content = self.png() if suffix == ".png" else self.vector(suffix[1:])
        with replacing(path) as temporary:
            temporary.write_bytes(content)

    def vector(self, format: str) -> bytes:
        """Return a "pdf" or "svg" file with the picture's pixels below lines and text."""
        left, _, bottom, _ = self.box
        paper, plain = self._sheet.paper or "none", self._sheet.pixels
        below = self.figure.figimage(plain, left, bottom, origin="lower", zorder=-1)
        stream = io.BytesIO()
        try:
            self.figure.savefig(stream, format=format, dpi=72, facecolor=paper)
        finally:
            below.remove()
        return stream.getvalue()

    def _repr_png_(self) -> bytes:
        return self.png()

    def __repr__(self) -> str:
        (height, width), (ny, nx) = self.rgba.shape[:2], self.picture.shape[:2]
        return f"<Annotated picture of {nx}×{ny} pixels on a sheet of {width}×{height}>"
