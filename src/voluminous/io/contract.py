"""The reader interface: a new format needs one file beside this one, and one entry in a list.

The readers of this package are listed in `io.registry`. Other packages register readers through
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
