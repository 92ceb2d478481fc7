"""The length that colours and opacities refer to."""

from __future__ import annotations

from typing import Any

from ..errors import InputError
from ..units import plain, split_text
from .given import plain_number, scalar

# As a path length: the median thickness in the volume (`calibration`).
AUTO = "auto"


def given_path_length(value: Any) -> Any:
    """Return a positive length, or "auto", which stays until the volume is known."""
    if isinstance(value, str):
        if value == AUTO:
            return value
        if split_text(value) is None:
            expected = "a number, a quantity such as '0.1 pc', or 'auto'"
            raise InputError(f"path_length must be {expected}, got {value!r}")
    length = scalar(value, "path_length")
    check_positive(length, "path_length")
    return length


def length_in(path_length: Any, unit: Any) -> float:
    """Return a path length as a number in the volume's unit; "auto" must have become one."""
    if isinstance(path_length, str):
        raise InputError(
            "path_length is still 'auto', which only a volume makes a number: use the medium that "
            "medium.calibrated(volume) returns (vm.render does that by itself)"
        )
    return float(plain(path_length, unit, "path_length"))


def check_positive(value: Any, what: str) -> None:
    """Refuse a number or quantity that is not positive."""
    if plain_number(value) <= 0:
        raise InputError(f"{what} must be positive, got {value}")
