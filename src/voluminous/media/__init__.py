"""From field values to emissivity and extinction: one file per medium (`media.contract`)."""

from .coefficients import Coefficients
from .contract import Context, Medium
from .function import Function
from .shaped import Gaussian, Rectangle, Shaped
from .sum import Sum
from .table import Colormap, Table

__all__ = [
    "Coefficients",
    "Colormap",
    "Context",
    "Function",
    "Gaussian",
    "Medium",
    "Rectangle",
    "Shaped",
    "Sum",
    "Table",
]
