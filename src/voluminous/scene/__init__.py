"""A scene in a file: volume, media, camera and options, in TOML.

`settings` reads and writes the TOML tables of plain values, `kinds` validates values, and
`sections` and `source` construct objects from them.
"""

from .scene import Scene

__all__ = ["Scene"]
