"""The reader interface: a new format needs one file beside this one, and one entry in a list.

The readers of this package are listed in `io.registry`. Other packages register readers through
the entry point group ``voluminous.readers``::

    [project.entry-points."voluminous.readers"]
    mycode = "mypackage.voluminous:MyCodeReader"
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from ..deferred import Deferred, Pieces
from ..errors import InputError
from ..units import UnitLike as UnitLike
from ..units import parse_unit, unit_name
from .names import chosen_fields

if TYPE_CHECKING:
    from ..grids.contract import Grid
    from ..volume import Volume

# All fields (None), one, several, or {name: place in the file}.
FieldChoice: TypeAlias = str | Sequence[str] | Mapping[str, str] | None


@dataclass(frozen=True)
class FieldInfo:
    """Description of a field in a file, without its values.

    Attributes
    ----------
    name : str
        Field name in `Reader.read`.
    place : str
        Location in the file.
    shape : tuple of int
        Shape in the file.
    dtype : str
        NumPy name of the type.
    unit : str
        Empty if there is none.
    """

    name: str
    place: str
    shape: tuple[int, ...]
    dtype: str
    unit: str = ""


class Reader:
    """One file format. Derive from this class, or provide the same attributes and methods.

    Attributes
    ----------
    name : str
        Short name, for ``open(path, format=name)``.
    description : str
        Description of such a file, with an article: "an HDF5 file".
    suffixes : tuple of str
        Usual suffixes of the file name, lower case with the dot.
    options : dict of str
        Option names of `read`, each with a line that explains it.
    writes : bool
        True if `write` is implemented.
    write_suffixes : tuple of str
        Suffixes that `write` supports, if not all.
    write_options : dict of str
        Option names of `write`, each with a line that explains it.
    writes_directory : bool
        True if `write` makes a directory.
    packages : tuple of str
        Required modules that may not be installed.
    extra : str
        The extra of voluminous that installs them: ``pip install "voluminous[extra]"``.
    remote : bool
        True if it also reads URLs (http, https, s3 …), passed as paths: `files.url_of`.
    """

    name: str = ""
    description: str = ""
    suffixes: tuple[str, ...] = ()
    options: dict[str, str] = {}  # noqa: RUF012 - subclasses replace it, nothing modifies it
    writes: bool = False
    write_suffixes: tuple[str, ...] = ()
    write_options: dict[str, str] = {}  # noqa: RUF012 - as above
    writes_directory: bool = False
    packages: tuple[str, ...] = ()
    extra: str = ""
    remote: bool = False

    def matches(self, path: Path, head: bytes) -> bool:
        """Return True if this reader is for the file.

        Parameters
        ----------
        path : Path
            The file, or directory.
        head : bytes
            The first bytes of the file (at most `registry.HEAD_LENGTH`); empty for a directory. A
            format within a general one, such as a code's HDF5 layout, must open the file; it is
            tried before the general one.
        """
        raise NotImplementedError

    def holds_image(self, path: Path) -> bool:
        """Return True if a file of this format is a picture, to be read by `Image.load`."""
        return False

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        """Return the volume in a file.

        Parameters
        ----------
        path : Path
            An existing file.
        fields : None, str, sequence of str or dict
            Fields to read: all, one, several, or ``{name: place in the file}``. Others need not be
            read.
        **options
            Options listed in `options`; the caller has checked the names.

        Notes
        -----
        Return fields as `voluminous.deferred.Deferred`: `open` reads small files at once, and each
        field of large files on first use. Errors are explained in both cases.

        Raises
        ------
        VoluminousError
            For errors that the user can correct. Any other exception becomes a `FileFormatError`.
        """
        raise NotImplementedError

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        """Return the descriptions of the fields in a file, without reading values."""
        raise NotImplementedError

    def write(self, volume: Volume, path: Path) -> None:
        """Write a volume to a new file, or into an empty directory, such that `read` restores it.

        The options in `write_options` are passed as keywords.
        """
        raise InputError(f"voluminous cannot write {self.description}")


@dataclass(frozen=True)
class StoredField:
    """A field in a file: its description, and a function that reads it."""

    name: str
    place: str
    shape: tuple[int, ...]
    dtype: Any
    unit: UnitLike
    load: Callable[[], Any]  # returns what `Volume` accepts as a field
    pieces: Pieces | None = None

    @property
    def info(self) -> FieldInfo:
        """The description without the function."""
        unit = unit_name(parse_unit(self.unit))
        return FieldInfo(self.name, self.place, self.shape, str(self.dtype), unit)


@dataclass(frozen=True)
class Contents:
    """The contents of a file; `grid` returns the grid of some of its fields."""

    fields: Sequence[StoredField]
    grid: Callable[[Sequence[StoredField]], Grid]
    meta: dict[str, Any] = field(default_factory=dict)  # complete once the grid is made


class ContentsReader(Reader):
    """Base of the readers that need to provide `contents` only."""

    def contents(self, path: Path, **options: Any) -> Contents:
        """Return the contents of a file, without field values."""
        raise NotImplementedError

    def chosen(self, contents: Contents, fields: FieldChoice) -> Mapping[str, StoredField]:
        """Return {name: field} for the fields that the user requests."""
        by_place = {f.place: f for f in contents.fields}
        names = {f.place: f.name for f in contents.fields}
        return {name: by_place[place] for name, place in chosen_fields(names, fields).items()}

    def finish(self, volume: Volume, contents: Contents) -> None:
        """Add to a volume what is neither a grid, a field nor metadata."""

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        from ..volume import Volume

        contents = self.contents(path, **options)
        chosen = self.chosen(contents, fields)
        volume = Volume(contents.grid(list(chosen.values())))
        volume.meta.update(contents.meta)
        for name, f in chosen.items():
            volume[name] = Deferred(f.load, f.dtype, f.unit, f.pieces)
        self.finish(volume, contents)
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        return tuple(f.info for f in self.contents(path, **options).fields)
