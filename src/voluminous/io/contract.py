"""What a reader promises: one format, one file beside this one, and one entry in a list.

The readers of this package are listed in `io.registry`. Those of other packages are found through
the entry point group ``voluminous.readers``::

    [project.entry-points."voluminous.readers"]
    mycode = "mypackage.voluminous:MyCodeReader"
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from ..errors import InputError
from ..units import UnitLike as UnitLike

if TYPE_CHECKING:
    from ..volume import Volume

# All fields (None), one, several, or {name: place in the file}.
FieldChoice: TypeAlias = str | Sequence[str] | Mapping[str, str] | None


@dataclass(frozen=True)
class FieldInfo:
    """A field as the file tells of it, without reading its values.

    Attributes
    ----------
    name : str
        The name `Reader.read` gives it.
    place : str
        Where it is in the file.
    shape : tuple of int
        As it is in the file.
    dtype : str
        NumPy's name of the type.
    unit : str
        Empty where there is none.
    """

    name: str
    place: str
    shape: tuple[int, ...]
    dtype: str
    unit: str = ""


class Reader:
    """One file format. Derive from this, or provide the same names.

    Attributes
    ----------
    name : str
        Short, for ``open(path, format=name)``.
    description : str
        What such a file is, with an article: "an HDF5 file".
    suffixes : tuple of str
        Usual endings of the file's name, lower case with the dot.
    options : dict of str
        Names of the options that `read` takes, each with a line that says what it is for.
    writes : bool
        True if `write` is there.
    write_suffixes : tuple of str
        Endings that `write` knows, if these are not all.
    write_options : dict of str
        Names of the options that `write` takes, each with a line that says what it is for.
    writes_directory : bool
        True if what `write` makes is a directory.
    packages : tuple of str
        Modules that are needed and not always there.
    extra : str
        The extra of voluminous that brings them: ``pip install "voluminous[extra]"``.
    remote : bool
        True if it also reads URLs (http, https, s3 …), which come as paths: `files.url_of`.
    """

    name: str = ""
    description: str = ""
    suffixes: tuple[str, ...] = ()
    options: dict[str, str] = {}  # noqa: RUF012 - a subclass replaces it, nothing changes it
    writes: bool = False
    write_suffixes: tuple[str, ...] = ()
    write_options: dict[str, str] = {}  # noqa: RUF012 - as above
    writes_directory: bool = False
    packages: tuple[str, ...] = ()
    extra: str = ""
    remote: bool = False

    def matches(self, path: Path, head: bytes) -> bool:
        """Return True if this is the reader for a file.

        Parameters
        ----------
        path : Path
            The file, or directory.
        head : bytes
            Its first bytes (at most `registry.HEAD_LENGTH`); none of a directory. A format inside
            a general one, such as a code's own HDF5 layout, has to look into the file: it is asked
            before the general one.
        """
        raise NotImplementedError

    def holds_image(self, path: Path) -> bool:
        """Return True for a file of this format that is a picture: `Image.load` reads it."""
        return False

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        """Return the volume in a file.

        Parameters
        ----------
        path : Path
            The file, which exists.
        fields : None, str, sequence of str or dict
            Which fields to read: all, one, several, or ``{name: place in the file}``. Nothing else
            need be read.
        **options
            Those in `options`; names are checked before.

        Notes
        -----
        Give fields as `voluminous.deferred.Deferred`: `open` reads small files at once, and of
        large ones each field when it is first used. Errors are explained in both cases.

        Raises
        ------
        VoluminousError
            For what the user can mend. Anything else that is raised becomes a `FileFormatError`.
        """
        raise NotImplementedError

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        """Return what there is to read, without reading it."""
        raise NotImplementedError

    def write(self, volume: Volume, path: Path) -> None:
        """Write a volume to a new file, or into an empty directory, so that `read` gives it back.

        What is in `write_options` comes as keywords.
        """
        raise InputError(f"voluminous cannot write {self.description}")
