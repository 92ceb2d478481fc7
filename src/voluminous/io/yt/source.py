"""What a user gives: a data set of yt, or a region of one; its cells and values, part by part."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ...packages import require


@dataclass(frozen=True)
class Source:
    """Cells of a data set.

    Attributes
    ----------
    ds : yt Dataset
    region : yt data object
        With the cells; of a whole data set all.
    whole : bool
        True if these are all cells there are.
    kind : {"grids", "octree", "particles", "sampled"}
        How they are kept: "sampled" is an array that yt makes of any.
    """

    ds: Any
    region: Any
    whole: bool
    kind: str

    def cells(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield level (n,) and index (n, 3) of consecutive cells, in yt's order of axes."""
        # Of AMReX with different ratios yt numbers levels with gaps.
        gaps = getattr(self.ds, "level_offsets", ())
        numbers = np.arange(len(gaps)) + gaps
        for part in self.region.chunks([], "io"):
            # As whole numbers: nothing has to be rounded to find a cell.
            level = np.asarray(part.ires)
            yield np.searchsorted(numbers, level) if len(gaps) else level, np.asarray(part.icoords)

    def values(self, field: tuple[str, str], unit: Any) -> np.ndarray:
        """Return a field in all cells, in the order of `cells`, as plain numbers in yt's unit."""
        # Within a part yt keeps what it reads to itself: the user's region stays as it is.
        parts = [plain_values(p[field], unit) for p in self.region.chunks([], "io")]
        return np.concatenate(parts)


def source_of(data: Any) -> Source:
    """Return the source that a data set or region is.

    Raises
    ------
    InputError
        If it has no cells in three dimensions.
    """
    static = require("yt.data_objects.static_output", "yt", "from_yt")
    containers = require("yt.data_objects.selection_objects.data_selection_objects", "yt", "")
    if isinstance(data, static.Dataset):
        return Source(data, data.all_data(), True, _kind(data))
    if not isinstance(data, containers.YTSelectionContainer) or not hasattr(data, "ds"):
        raise InputError(
            f"from_yt needs a data set of yt or a region of one (ds, ds.sphere(…), ds.box(…)), got "
            f"{type(data).__name__}; yt.load(path) gives a data set"
        )
    if getattr(data, "_dimensionality", 0) != 3:
        raise InputError(
            f"from_yt needs a region in three dimensions, got a {data._type_name}; give the data "
            "set, or ds.box(…), ds.sphere(…), ds.disk(…), a cut region …"
        )
    grids = require("yt.data_objects.construction_data_containers", "yt", "from_yt")
    if isinstance(data, grids.YTCoveringGrid):
        return Source(data.ds, data, False, "sampled")
    return Source(data.ds, data, False, _kind(data.ds))


def _kind(ds: Any) -> str:
    modules = {
        "grids": "yt.geometry.grid_geometry_handler:GridIndex",
        "particles": "yt.geometry.particle_geometry_handler:ParticleIndex",
        "mesh": "yt.geometry.unstructured_mesh_handler:UnstructuredIndex",
    }
    for kind, place in modules.items():
        module, _, name = place.partition(":")
        if isinstance(ds.index, getattr(require(module, "yt", "from_yt"), name)):
            if kind == "mesh":
                raise InputError(
                    f"{ds} is an unstructured mesh (or has uneven cells that yt keeps as one); "
                    "sample it first: vm.from_yt(ds.arbitrary_grid(left, right, dims))"
                )
            return kind
    return "octree"  # all others have cells that are halved


def plain_values(values: Any, unit: Any) -> np.ndarray:
    """Return an array of yt as plain numbers in a unit of its, of type float64."""
    converted = values.to(unit) if hasattr(values, "units") else values
    return np.asarray(getattr(converted, "d", converted), dtype=np.float64)
