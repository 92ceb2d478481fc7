"""New figures of matplotlib: where figures are shown they are, else they have no window."""

from __future__ import annotations

import sys
from typing import Any


def new_figure() -> Any:
    """Return a figure, which pyplot or the notebook knows of where one of them is in use."""
    # pyplot keeps every figure alive and chooses a window system; only a program or a notebook
    # that uses it already wants that.
    if "matplotlib.pyplot" in sys.modules or _in_notebook():
        import matplotlib.pyplot as plt

        return plt.figure(layout="constrained")
    from matplotlib.figure import Figure

    return Figure(layout="constrained")


def _in_notebook() -> bool:
    shell = sys.modules.get("IPython")
    return shell is not None and shell.get_ipython() is not None
