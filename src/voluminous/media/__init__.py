"""From field values to emissivity and extinction: one file per medium (`media.contract`)."""

from .coefficients import Coefficients
from .color_by import ColorBy
from .colormap import Colormap
from .context import Context
from .contract import Medium
from .function import Function
from .gaussian import Gaussian
from .isosurface import Isosurface
from .profiles import Shaped
from .rectangle import Rectangle
from .sum import Sum
from .table import Table

# The media a scene file can name.
MEDIA = {
    "gaussian": Gaussian,
    "rectangle": Rectangle,
    "table": Table,
    "colormap": Colormap,
    "coefficients": Coefficients,
    "isosurface": Isosurface,
}

__all__ = [
    "MEDIA",
    "Coefficients",
    "ColorBy",
    "Colormap",
    "Context",
    "Function",
    "Gaussian",
    "Isosurface",
    "Medium",
    "Rectangle",
    "Shaped",
    "Sum",
    "Table",
]
