"""A scene in a file: volume, media, camera and options, in TOML.

`settings` are its tables of plain values, `kinds` says what values may be, `sections` and `source`
make objects of them, `toml` reads and writes the text.
"""

from .scene import Scene

__all__ = ["Scene"]
