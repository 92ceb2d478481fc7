"""yt without its talk: imported when needed, silent while it works for us."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...packages import require

_SILENT = logging.CRITICAL + 1
_BARS = ("yt", "suppress_stream_logging")


@contextmanager
def quiet(purpose: str = "reading this file") -> Iterator[Any]:
    """Give yt, with its log, bars and warnings off; all is as before afterwards.

    Raises
    ------
    MissingPackageError
        If yt is not installed.
    """
    yt = require("yt", "yt", purpose)
    logger, config = logging.getLogger("yt"), require("yt.config", "yt", purpose).ytcfg
    level, bars = logger.level, config.get(*_BARS)
    logger.setLevel(_SILENT)
    config.set(*_BARS, True)
    try:
        # Derived fields divide by zero in empty cells.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield yt
    finally:
        logger.setLevel(level)
        config.set(*_BARS, bars)
