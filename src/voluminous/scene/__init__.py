"""A scene in a file: volume, media, camera and options, in TOML.

`kinds` says what values may be, `sections` and `source` make objects of the sections, `toml` reads
and writes the text.
"""

from .scene import Scene

__all__ = ["Scene"]
