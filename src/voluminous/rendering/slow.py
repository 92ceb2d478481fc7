"""Choices that make pictures several times slower are named once, with the alternative."""

from __future__ import annotations

import logging

# Pictures that take less than this many seconds say nothing.
_LONG = 5.0
# Measured on two shells of 100³ cells, 300² pixels, relative to the defaults.
_SLOW = {
    "adaptive": "samples='adaptive' takes up to 256 rays per pixel, about 100 times as long as one "
    "ray; samples=4 takes 16 rays",
    "bounds": "bounds=True takes about 60 times as long; image.error is an estimate without it",
    "tolerance": "a tolerance below 1e-5 takes double precision, 5 to 20 times as long as 1e-3",
    "double": "precision='double' takes 2 to 5 times as long as 'single'",
}
_named: set[str] = set()


def name_slow_choices(seconds: float, **chosen: bool) -> None:
    """Log a warning, once per process and choice, if a picture took long."""
    slow = [name for name in _SLOW if chosen.get(name) and name not in _named]
    if seconds > _LONG and slow:
        _named.update(slow)
        advice = "; ".join(_SLOW[name] for name in slow)
        logging.getLogger("voluminous").warning("%.0f s for a picture: %s", seconds, advice)
