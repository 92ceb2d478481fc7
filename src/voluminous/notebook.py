"""HTML of values for notebooks: tables and small pictures."""

from __future__ import annotations

import base64
import html
import io
import reprlib
from collections.abc import Iterable, Sequence
from typing import Any

_LEFT = " style='text-align:left'"


def page(title: str, *parts: str) -> str:
    """Return a title and what is below it."""
    return f"<b>{html.escape(title)}</b>{''.join(parts)}"


def table(rows: Iterable[Sequence[Any]], head: Sequence[str] = ()) -> str:
    """Return rows of which the first cell is the name; texts are shown as they are."""
    heads = f"<tr>{''.join(f'<th{_LEFT}>{html.escape(cell)}</th>' for cell in head)}</tr>"
    lines = (
        f"<tr><th{_LEFT}>{html.escape(str(name))}</th>"
        f"{''.join(f'<td{_LEFT}>{html.escape(_text(cell))}</td>' for cell in cells)}</tr>"
        for name, *cells in rows
    )
    return f"<table>{heads if head else ''}{''.join(lines)}</table>"


def _text(value: Any) -> str:
    return value if isinstance(value, str) else reprlib.repr(value)


def png(pixels: Any) -> bytes:
    """Return a picture of shape (ny, nx, 3) or (ny, nx, 4) as a PNG file, row 0 at the bottom."""
    from matplotlib.image import imsave

    stream = io.BytesIO()
    imsave(stream, pixels, origin="lower", format="png")
    return stream.getvalue()


def picture(data: bytes, title: str) -> str:
    """Return a PNG file below its title."""
    text = html.escape(title, quote=True)
    source = f"data:image/png;base64,{base64.b64encode(data).decode()}"
    return f"<p>{text}<br><img src='{source}' alt='{text}'></p>"
