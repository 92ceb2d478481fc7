"""Which dimensions of an array with names are x, y and z."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...errors import InputError, unknown_name
from ..axis_names import AXES


def checked_dims(dims: Any, there: Sequence[str]) -> tuple[str, ...]:
    """Return the dimensions that a user names for x, y and z.

    Raises
    ------
    InputError
        If they are not three names, or ``{"x": …, "y": …, "z": …}``.
    UnknownNameError
        If there is no such dimension.
    """
    names = [dims.get(axis) for axis in AXES] if isinstance(dims, Mapping) else dims
    listed = list(names) if isinstance(names, (list, tuple)) else []
    if len(listed) != 3 or len({str(name) for name in listed}) != 3:
        raise InputError(
            f"dims must name the dimensions along x, y and z, such as {tuple(there)[-3:][::-1]}, "
            f"got {dims!r}"
        )
    for name in listed:
        if name not in there:
            raise unknown_name("dimension", str(name), there)
    return tuple(listed)


def spatial_dims(sizes: Mapping[str, int], axes: Mapping[str, str]) -> tuple[str, ...]:
    """Return the dimensions of an array along x, y and z.

    Where there are more than three, those of length one that are no axes of space are left out.
    Dimensions that do not tell what they are get the axes that are left, in their order.

    Parameters
    ----------
    sizes : mapping
        Dimension → length, in the array's order.
    axes : mapping
        Dimension → axis, as `axis_of` gives it.

    Raises
    ------
    InputError
        If more or less than three are left, or one of them is a time; says what to do.
    """
    kept = list(sizes)
    for rank in ("t", ""):
        single = [dim for dim in kept if sizes[dim] == 1 and axes[dim] == rank]
        for dim in single[: max(0, len(kept) - 3)]:
            kept.remove(dim)
    if len(kept) != 3:
        raise InputError(_told(sizes, kept, axes))
    ordered = _ordered(kept, axes)
    if "t" in (axes[dim] for dim in ordered):
        raise InputError(
            f"({_listed(sizes)}) are not three dimensions of space; to take the time for one, say "
            f"dims={ordered}"
        )
    return ordered


def _ordered(dims: Sequence[str], axes: Mapping[str, str]) -> tuple[str, ...]:
    found: dict[str, str] = {}
    for dim in dims:
        if axes[dim] in tuple(AXES):
            found.setdefault(axes[dim], dim)
    rest = [dim for dim in dims if dim not in found.values()]
    return tuple(found[axis] if axis in found else rest.pop(0) for axis in AXES)


def _told(sizes: Mapping[str, int], kept: Sequence[str], axes: Mapping[str, str]) -> str:
    if len(kept) < 3:
        return f"expected three dimensions, got ({_listed(sizes)})"
    extra = [d for d in kept if axes[d] == "t"] or [d for d in kept if not axes[d]] or [kept[0]]
    chosen = extra[: len(kept) - 3]
    first = ", ".join(f"{dim!r}: 0" for dim in chosen)
    typed = ", ".join(f"{dim}=0" for dim in chosen)
    return (
        f"expected three dimensions, got ({_listed(sizes)}); choose one of "
        f"{' and one of '.join(chosen)} with isel={{{first}}} (by number; on the command line "
        f"--set 'isel={{{typed}}}') or sel={{{chosen[0]!r}: …}} (by value)"
    )


def _listed(sizes: Mapping[str, int]) -> str:
    return ", ".join(f"{dim}: {n}" for dim, n in sizes.items())
