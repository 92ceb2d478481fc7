"""Colour bars to the right of the picture, each with a histogram on its left."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .sheet import LINE

if TYPE_CHECKING:
    from .scales import Scale
    from .sheet import Sheet

_GAP, _BAR, _COUNTS = 1.0, 1.1, 2.8


def draw_color_bar(sheet: Sheet, scale: Scale, counts: Any, start: float) -> float:
    """Draw a bar as high as the picture; return how far to the right it reaches, in its pixels.

    Parameters
    ----------
    sheet : Sheet
    scale : Scale
    counts : array or None
        What `histogram.counts` gives.
    start : float
        Where what is to the left of it ends.
    """
    x = start + _GAP * sheet.em
    if counts is not None:
        _draw_counts(sheet, counts, x)
        x += _COUNTS * sheet.em
    axes = sheet.axes(x, 0.0, _BAR * sheet.em, float(sheet.height), gid="color-bar")
    _draw_colors(sheet, axes, scale)
    return sheet.end(axes)


def _draw_counts(sheet: Sheet, counts: Any, x: float) -> None:
    axes = sheet.axes(x, 0.0, _COUNTS * sheet.em, float(sheet.height), gid="histogram")
    edges = np.linspace(0.0, 1.0, len(counts) + 1)
    axes.stairs(counts, edges, orientation="horizontal", fill=True, color=sheet.ink, alpha=0.45)
    axes.set(xlim=(1.05, 0.0), ylim=(0.0, 1.0))
    axes.set_axis_off()


def _draw_colors(sheet: Sheet, axes: Any, scale: Scale) -> None:
    bar = sheet.figure.colorbar(scale.mappable, cax=axes)
    bar.outline.set(linewidth=LINE * sheet.em, edgecolor=sheet.ink)
    axes.tick_params(which="both", colors=sheet.ink, labelsize=0.85 * sheet.em)
    axes.tick_params(which="both", width=LINE * sheet.em, pad=0.25 * sheet.em)
    axes.tick_params(which="major", length=0.35 * sheet.em)
    axes.tick_params(which="minor", length=0.2 * sheet.em)
    offset = axes.yaxis.get_offset_text()
    offset.set(fontsize=0.85 * sheet.em, color=sheet.ink, ha="left")
    label = bar.ax.set_ylabel(
        scale.label, fontsize=sheet.em, color=sheet.ink, labelpad=0.5 * sheet.em
    )
    long = label.get_window_extent(sheet.canvas.get_renderer()).height
    if long > sheet.height:
        label.set_fontsize(sheet.em * sheet.height / long)
