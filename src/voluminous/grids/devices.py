"""What of a grid is made for a device: once, and left out of copies and pickles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class OnDevices:
    """A grid that keeps what was made of it for a device, and a precision."""

    def on_device(self, backend: Any, what: str, make: Callable[[], Any]) -> Any:
        """Return what `make` returned the first time for a backend."""
        kept: dict[Any, Any] = self.__dict__.setdefault("_on_devices", {})
        key = (backend, what)
        if key not in kept:
            kept[key] = make()
        return kept[key]

    def __getstate__(self) -> dict[str, Any]:
        """Return all but what devices hold: another process makes its own."""
        return {name: value for name, value in vars(self).items() if name != "_on_devices"}
