"""RADMC-3D's files, written as its documentation says: plainly, and apart from the package."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

ENDINGS = {"text": "", "binary": "b", "records": "u"}


class Text:
    """A number of lines."""

    def __init__(self):
        self.content = b""

    def head(self, number, grid, single):
        self.integers(number)

    def integers(self, *numbers):
        self.content += (" ".join(str(n) for n in numbers) + "\n").encode()

    def reals(self, values, per_line=1):
        lines = np.reshape(values, (-1, per_line))
        self.content += "".join(
            " ".join(f"{x:23.16E}" for x in line) + "\n" for line in lines.tolist()
        ).encode()

    def flags(self, flags):
        self.content += b"".join(b"%d\n" % flag for flag in flags)

    data = reals


class Binary:
    """Numbers one after the other, in little-endian order unless told."""

    def __init__(self, order="<"):
        self.content, self.order, self.kind = b"", order, "f8"

    def head(self, number, grid, single):
        self.integers(number)
        if not grid:
            self.kind = "f4" if single else "f8"
            self.integers(4 if single else 8)

    def integers(self, *numbers):
        self.content += struct.pack(f"{self.order}{len(numbers)}q", *numbers)

    def reals(self, values, per_line=1):
        self.content += np.asarray(values).astype(self.order + "f8").tobytes()

    def flags(self, flags):
        self.content += bytes(int(f) for f in flags)

    def data(self, values, per_line=1):
        self.content += np.asarray(values).astype(self.order + self.kind).tobytes()


class Records:
    """Fortran's records: their lengths before and behind them."""

    length = 7  # values per record of data: the last one is filled up

    def __init__(self):
        self.content, self.whole = b"", "i"

    def record(self, content):
        mark = struct.pack("<i", len(content))
        self.content += mark + content + mark

    def head(self, number, grid, single):
        self.whole = "i" if grid else "q"
        self.integers(*([number] if grid else [number, 8 * self.length]))

    def integers(self, *numbers):
        self.record(struct.pack(f"<{len(numbers)}{self.whole}", *numbers))

    def reals(self, values, per_line=1):
        self.record(np.asarray(values, "<f8").tobytes())

    def flags(self, flags):
        for flag in flags:
            self.integers(int(flag))

    def data(self, values, per_line=1):
        values = np.asarray(values, "<f8")
        length = per_line if per_line > 1 else self.length
        padded = np.zeros(-(-len(values) // length) * length)
        padded[: len(values)] = values
        for part in padded.reshape(-1, length):
            self.record(part.tobytes())


KINDS = {"text": Text, "binary": Binary, "records": Records}


def path_of(directory, stem, encoding, ending="inp"):
    return Path(directory) / f"{stem}.{ENDINGS[encoding]}{ending}"


def put_grid(
    directory,
    walls,
    *,
    coordinates=1,
    active=(1, 1, 1),
    flags=None,
    layers=None,
    levels=None,
    encoding="text",
):
    """Write the grid; return its path."""
    out = KINDS[encoding]()
    out.head(1, True, False)
    out.integers(1 if flags is not None else 10 if layers is not None else 0)
    out.integers(coordinates)
    out.integers(0)
    out.integers(*active)
    out.integers(*(len(w) - 1 for w in walls))
    if flags is not None:
        leaves = len(flags) - int(np.sum(flags))
        out.integers(20 if levels is None else levels, leaves, len(flags))
    if layers is not None:
        out.integers(20 if levels is None else levels, len(layers))
    for w in walls:
        out.reals(w)
    if flags is not None:
        out.flags(flags)
    for layer in () if layers is None else layers:
        out.integers(*layer)
    path = path_of(directory, "amr_grid", encoding)
    path.write_bytes(out.content)
    return path


def put_field(directory, stem, *columns, encoding="text", single=False, ending="inp"):
    """Write a field, or the columns of a vector, each flat in the order of files."""
    out = KINDS[encoding]()
    out.head(1, False, single)
    out.integers(len(columns[0]))
    out.data(np.stack(columns, axis=1).ravel(), len(columns))
    path = path_of(directory, stem, encoding, ending)
    path.write_bytes(out.content)
    return path


def put_species(directory, stem, *species, encoding="text", single=False, ending="inp"):
    """Write one field per species, each flat in the order of files."""
    out = KINDS[encoding]()
    out.head(1, False, single)
    if encoding == "records":
        out.integers(len(species[0]), len(species))
    else:
        out.integers(len(species[0]))
        out.integers(len(species))
    for values in species:
        out.data(values)
    path = path_of(directory, stem, encoding, ending)
    path.write_bytes(out.content)
    return path


def in_file_order(array):
    """Return a field [i1, i2, i3] with the first index fastest."""
    n1, n2, n3 = array.shape
    return np.array([array[i, j, k] for k in range(n3) for j in range(n2) for i in range(n1)])
