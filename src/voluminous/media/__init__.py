"""From field values to emissivity and extinction: one file per medium (`media.contract`)."""

from .coefficients import Coefficients
from .contract import Context, Medium
from .function import Function
from .shaped import Gaussian, Rectangle, Shaped
from .sum import Sum
from .table import Colormap, Table

# The media a scene file can name.
MEDIA = {
    "gaussian": Gaussian,
    "rectangle": Rectangle,
    "table": Table,
    "colormap": Colormap,
    "coefficients": Coefficients,
}

__all__ = [
    "MEDIA",
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
