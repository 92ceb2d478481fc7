"""``import voluminous.xarray`` adds the accessor ``.voluminous`` to xarray's classes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import xarray

if TYPE_CHECKING:
    from .image import Image
    from .volume import Volume

# Options of `render` that go to `to_volume`; all others go to `voluminous.render`.
_PLACES = ("fields", "dims", "isel", "sel", "bounds", "spacing", "aspect", "unit")


class Accessor:
    """The accessor ``.voluminous`` of an xarray.DataArray or Dataset."""

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
            A text is a field or expression, for which `voluminous.suggest_medium` chooses the
            medium. Default: its choice for the whole volume.
        camera : camera, optional
            Default: the whole volume in the frame, seen obliquely from above.
        **options
            ``fields, dims, isel, sel, bounds, spacing, aspect, unit`` as in
            `voluminous.Volume.from_xarray`; all others as in `voluminous.render`.
        """
        from .calibration import suggest_medium
        from .drawing import render

        places = {name: options.pop(name) for name in _PLACES if name in options}
        volume = self.to_volume(**places)
        if isinstance(medium, str):
            medium = suggest_medium(volume, medium)
        return render(volume, medium, camera, **options)

    def __repr__(self) -> str:
        return "<voluminous: .to_volume(…), .render(…)>"


_attach: Any
for _kind, _attach in (
    (xarray.DataArray, xarray.register_dataarray_accessor),
    (xarray.Dataset, xarray.register_dataset_accessor),
):
    if not hasattr(_kind, "voluminous"):
        _attach("voluminous")(Accessor)
