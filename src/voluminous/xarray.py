"""``import voluminous.xarray`` gives xarray's arrays and data sets ``.voluminous``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import xarray

if TYPE_CHECKING:
    from .image import Image
    from .volume import Volume

# Options of `to_volume` that `render` takes too; all others are those of `voluminous.render`.
_PLACES = ("fields", "dims", "isel", "sel", "bounds", "spacing", "aspect", "unit")


class Accessor:
    """What ``.voluminous`` is on an xarray.DataArray or Dataset."""

    def __init__(self, data: Any) -> None:
        self._data = data

    def to_volume(self, fields: Any = None, **options: Any) -> Volume:
        """Return the volume; see `voluminous.Volume.from_xarray` for the options."""
        from .io import from_xarray

        return from_xarray(self._data, fields, **options)

    def render(self, medium: Any = None, camera: Any = None, **options: Any) -> Image:
        """Return a picture.

        Parameters
        ----------
        medium : Medium or str, optional
            By default `voluminous.suggest_medium` finds one, for the field or
            expression if that is given.
        camera : camera, optional
            By default all is seen, from obliquely above.
        **options
            ``fields, dims, isel, sel, bounds, spacing, aspect, unit`` as in
            `voluminous.Volume.from_xarray`; all others as in `voluminous.render`.
        """
        from .calibration import suggest_medium
        from .rendering import render

        places = {name: options.pop(name) for name in _PLACES if name in options}
        volume = self.to_volume(**places)
        if isinstance(medium, str):
            medium = suggest_medium(volume, medium)
        return render(volume, medium, camera, **options)

    def __repr__(self) -> str:
        return "<voluminous: .to_volume(…), .render(…)>"


for _kind, _attach in (
    (xarray.DataArray, xarray.register_dataarray_accessor),
    (xarray.Dataset, xarray.register_dataset_accessor),
):
    if not hasattr(_kind, "voluminous"):
        _attach("voluminous")(Accessor)
