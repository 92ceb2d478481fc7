"""What a notebook shows of a volume: three slices, and a table of its fields."""

from __future__ import annotations

import base64
import html
import io
from typing import Any

import numpy as np

from ..colormaps import get_colormap

_PIXELS, _VALUES, _MOST_FIELDS, _WIDE = 96, 1 << 18, 40, 100.0


def volume_html(volume: Any) -> str:
    """Return grid, fields and slices as HTML; what waits in a file is not read for it."""
    names, waiting = list(volume), set(volume.waiting)
    rows = "".join(_row(volume, name, name in waiting) for name in names[:_MOST_FIELDS])
    more = f"<p>and {len(names) - _MOST_FIELDS} more</p>" if len(names) > _MOST_FIELDS else ""
    heads = "".join(f"<th>{head}</th>" for head in ("field", "unit", "least", "greatest", "NaN"))
    shown = next((name for name in names if name not in waiting), None)
    picture = _picture(volume, shown) if shown else ""
    title = html.escape(repr(volume.grid))
    return f"<b>Volume</b> on {title}{picture}<table><tr>{heads}</tr>{rows}</table>{more}"


def _row(volume: Any, name: str, waits: bool) -> str:
    unit = volume.describe()["fields"][name]["unit"]
    cells = [name, unit, *(("not read yet", "", "") if waits else _statistics(volume.array(name)))]
    return f"<tr>{''.join(f'<td>{html.escape(str(cell))}</td>' for cell in cells)}</tr>"


def _statistics(array: np.ndarray) -> tuple[str, str, str]:
    step = max(1, array.size // _VALUES)
    values = np.asarray(array).flat[::step]
    lacking = np.isnan(values) if values.dtype.kind == "f" else np.zeros(values.shape, bool)
    about = "≈ " if step > 1 else ""
    part = f"{about}{lacking.mean():.3g}" if lacking.any() else "0"
    if lacking.all():
        return "", "", part
    good = values[~lacking]
    return f"{about}{good.min():.4g}", f"{about}{good.max():.4g}", part


def _picture(volume: Any, name: str) -> str:
    """Return slices through the middle of a field, across x, y and z, beside each other."""
    from matplotlib.image import imsave

    slices = [volume.slice(name, axis, resolution=_PIXELS).values for axis in "xyz"]
    finite = np.concatenate([values[np.isfinite(values)] for values in slices])
    if not finite.size:
        return ""
    low, high = float(finite.min()), float(finite.max())
    if low > 0.0 and high > _WIDE * low:
        slices, low, high = [np.log10(v) for v in slices], np.log10(low), np.log10(high)
    page = np.ones((_PIXELS, 3 * _PIXELS + 8, 4))
    for k, values in enumerate(slices):
        rgba = get_colormap("viridis")((values - low) / ((high - low) or 1.0))
        ny, nx = values.shape
        page[:ny, k * (_PIXELS + 4) : k * (_PIXELS + 4) + nx] = rgba
    stream = io.BytesIO()
    imsave(stream, np.repeat(np.repeat(page, 2, 0), 2, 1), origin="lower", format="png")
    data = base64.b64encode(stream.getvalue()).decode()
    title = f"{html.escape(name)}, across x, y and z"
    return f"<p>{title}<br><img src='data:image/png;base64,{data}' alt='{title}'></p>"
