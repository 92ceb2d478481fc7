"""Figures of matplotlib, without a window unless pyplot is in use, and their colour bars."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from .errors import InputError

# Of a colour bar, and of its distance: in longer sides of the picture.
_BAR_WIDTH = 0.05
# Of a bar beside a flat picture: in widths of the picture, so that its numbers can be read.
_BAR_HEIGHT = 0.4
# From one bar to the next: room for its numbers and label.
_BAR_ROOM = 0.3


def new_figure() -> Any:
    """Return a figure, which pyplot or the notebook knows of where one of them is in use."""
    # pyplot keeps every figure alive and chooses a window system; only a program or a notebook
    # that uses it already wants that.
    if "matplotlib.pyplot" in sys.modules or _in_notebook():
        import matplotlib.pyplot as plt

        return plt.figure(layout=_layout())
    from matplotlib.figure import Figure

    return Figure(layout=_layout())


def _layout() -> Any:
    """Return a constrained layout that is computed three times: after one, labels are cut off."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    class Settled(ConstrainedLayoutEngine):
        def execute(self, fig: Any) -> Any:
            super().execute(fig)
            super().execute(fig)
            return super().execute(fig)

        def __reduce__(self) -> Any:
            return _layout, ()  # figures can be pickled

    return Settled()


def divided(ax: Any, count: int, *, share: bool = True) -> Any:
    """Return so many axes over one another: those given, or the parts of one."""
    given = np.ravel(np.array(ax, dtype=object))
    if not all(hasattr(one, "get_subplotspec") for one in given):
        raise InputError(f"ax must be axes of matplotlib, got {ax!r}")
    if len(given) == count:
        return given
    if len(given) != 1:
        raise InputError(f"ax must be one axes to be divided, or {count}, got {len(given)}")
    spec, parent = given[0].get_subplotspec(), given[0].get_figure()
    if spec is None:
        raise InputError(f"ax must be a subplot of a figure, which can be divided, or {count} axes")
    given[0].set_axis_off()
    places = spec.subgridspec(count, 1)
    panels = [parent.add_subplot(places[0])]
    panels += [
        parent.add_subplot(places[k], sharex=panels[0] if share else None) for k in range(1, count)
    ]
    for panel in panels[:-1] if share else ():
        panel.tick_params(labelbottom=False)
    return panels


def add_color_bar(axes: Any, shown: Any, label: str, *, own: bool, number: int = 0) -> Any:
    """Put a colour bar beside a picture.

    Parameters
    ----------
    axes : matplotlib Axes or list of them
        With nothing but the picture in them; the bar of several takes its room from all.
    shown : matplotlib ScalarMappable
    label : str
    own : bool
        Whether nothing else is in the figure. Then, or if the figure has a layout, the bar is as
        high as the picture, and no label is cut off; else it takes its room from `axes`.
    number : int
        Number of bars that there are already.

    Returns
    -------
    matplotlib Colorbar
    """
    if isinstance(axes, list):
        return axes[0].get_figure().colorbar(shown, ax=axes, label=label)
    figure = axes.get_figure()
    if not own and not figure.get_layout_engine():
        return figure.colorbar(shown, ax=axes, label=label)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    steep = abs((top - bottom) / (right - left)) * float(axes.get_aspect())
    width, height = _BAR_WIDTH * max(1.0, steep), max(1.0, _BAR_HEIGHT / steep)
    place = (1.0 + width + _BAR_ROOM * number, 0.5 * (1.0 - height), width, height)
    return figure.colorbar(shown, cax=axes.inset_axes(place), label=label)


def _in_notebook() -> bool:
    shell = sys.modules.get("IPython")
    return shell is not None and shell.get_ipython() is not None
