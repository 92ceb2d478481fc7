"""Reader selection: the readers of this package and those that other packages register; saving."""

from __future__ import annotations

import builtins
import contextlib
import functools
import importlib.metadata
import itertools
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import FileFormatError, InputError, unknown_name
from ..files import as_path, check_readable, missing, new_directory, opening, replacing, url_of
from ..packages import REGISTERED
from .arrays.hdf5 import HDF5Reader
from .arrays.npz import NPYReader, NPZReader
from .athena import AthenaReader, PlutoReader
from .compressed import PackedReader
from .contract import FieldChoice, Reader
from .fits.reader import CASAReader, FITSReader
from .guard import placed, reading
from .labelled.netcdf import GRIBReader, NetCDFReader
from .native.reader import NativeReader
from .native.zarr import NativeZarrReader
from .nexus import NeXusReader
from .openpmd import OpenPMDReader
from .openvdb import OpenVDBReader
from .particles.gadget import GadgetReader
from .particles.phantom import PhantomReader
from .raw import RawReader
from .remote import head_of
from .scanners.dicom import DICOMReader
from .scanners.hdf5_images import ImarisReader, ITKReader
from .scanners.metaimage import MetaImageReader
from .scanners.mrc import MRCReader
from .scanners.neuroimaging import AFNIReader, MGHReader, MINCReader, NIfTIReader, PARRECReader
from .scanners.nrrd import NRRDReader
from .scanners.tiff import PicturesReader, TIFFReader
from .vtk.anything import PyVistaReader, VTKReader
from .vtk.hdf import VTKHDFReader
from .vtk.xml import VTIReader, VTKXMLReader, VTRReader
from .yt.reader import AnyYtReader, YtReader
from .zarr.arrays import LabelledZarrReader, ZarrReader
from .zarr.ome import OMEZarrReader
from .zarr.store import forget

if TYPE_CHECKING:
    import numpy as np

    from ..volume import Volume

# General formats come last, because codes store specific layouts in them.
READERS: tuple[Reader, ...] = (
    NativeReader(),
    VTIReader(),
    VTRReader(),
    VTKXMLReader(),
    VTKReader(),
    VTKHDFReader(),
    OpenVDBReader(),
    CASAReader(),
    FITSReader(),
    AthenaReader(),
    PlutoReader(),
    GadgetReader(),
    PhantomReader(),
    OpenPMDReader(),
    YtReader(),
    MINCReader(),
    NeXusReader(),
    PyVistaReader(),  # CGNS and Exodus are stored in HDF5 and NetCDF
    NetCDFReader(),
    NativeZarrReader(),
    OMEZarrReader(),
    LabelledZarrReader(),
    ZarrReader(),
    DICOMReader(),
    ITKReader(),
    ImarisReader(),
    NIfTIReader(),
    MRCReader(),
    MGHReader(),
    AFNIReader(),
    PARRECReader(),
    NRRDReader(),
    MetaImageReader(),
    TIFFReader(),
    PicturesReader(),
    NPZReader(),
    NPYReader(),
    HDF5Reader(),
    GRIBReader(),
    RawReader(),
    PackedReader(lambda path: find_reader(path), lambda *asked: check_options(*asked)),
    AnyYtReader(lambda path: reader_for_suffix(path)),
)
GROUP = "voluminous.readers"
# Enough for the magic bytes of all formats, and for the first keyword of a text file.
HEAD_LENGTH = 4096
# Fields of up to this many bytes in total are read on opening; beyond, each on first use.
AT_ONCE = 256 << 20
# Number of directory entries that are tried (there may be a million), and that are listed.
_ENTRIES, _LISTED = 256, 8


def open(
    path: str | Path | Sequence[str | Path],
    fields: FieldChoice = None,
    *,
    format: str | None = None,
    **options: Any,
) -> Volume:
    """Return the volume in a file, or in several.

    Parameters
    ----------
    path : str, Path or a list of them
        The file; the fields of several are together on the grid of the first. Where another's grid
        differs, it is resampled (labels: nearest, other fields: linear), and
        ``volume.meta["notes"]`` says so. A table of labels (``.ctbl``, ``.lut``, ``.label``) gives
        those of the file before it their names and colours. The format is detected from the
        content. For Zarr and HDF5 also a URL: ``"https://…/cells.zarr"``, ``"s3://…/cells.zarr"``.
    fields : None, str, sequence of str or dict, optional
        Fields of the volume: all (None), one, several, or ``{name: place in the file}``, such as
        ``{"density": "/gas/rho"}``. Only these are read; if they take more than 256 MiB, each is
        read on first use (`Volume.load` reads them all).
    format : str, optional
        Name of the reader, if the format cannot be detected.
    **options
        Options of the reader. NPZ, NPY and HDF5: ``bounds``, ``spacing`` or the cell edges
        ``x, y, z`` (default: those in the file, else cells of unit length), ``unit`` of length,
        and ``axes="zyx"`` if z is the first axis of the arrays. Of any file that has coarser
        levels, ``level=1`` … opens one of these (`Volume.level`).

    Returns
    -------
    Volume

    Raises
    ------
    FileFormatError
        If the file is damaged, or if no reader supports its format.
    UnknownNameError
        If an option, format or field does not exist; the message names the nearest.
    InputError
        If the file does not exist, or if its contents cannot make a volume.

    Examples
    --------
    >>> volume = vm.open("snapshot.h5", {"density": "/gas/rho"}, unit="pc", bounds=(-1, 1))
    """
    volume = open_lazily(path, fields, format=format, **options)
    # In all but large files, damage is detected at once.
    return volume.load() if volume.bytes_waiting <= AT_ONCE else volume


def open_lazily(
    path: Any, fields: FieldChoice = None, *, format: str | None = None, **options: Any
) -> Volume:
    """Same as `open`, but each field is read on first use."""
    if isinstance(path, (list, tuple)):
        from .together import open_together

        return open_together(path, fields, format=format, **options)
    path = as_path(path)
    if url_of(path):
        forget()
    reader = find_reader(path, format)
    shown = url_of(path) or path
    # Readers without such an option have levels that the volume's store reads.
    level = 0 if "level" in reader.options else options.pop("level", 0)
    with placed(shown):
        check_options(reader, options)
    place = path if url_of(path) else path.absolute()  # for processes that stand elsewhere
    opened = opening(place)
    guard = functools.partial(reading, shown, reader.description, opened)
    with guard():
        volume = reader.read(place, fields, **options)
    known = opened[2][0] if opened[0].is_file() else ""
    again = _OpenedAgain(place, fields, format, options)
    volume.explain_reading(guard, (opened[0], repr((fields, format, options)), known), again)
    volume.own()
    if level == 0:
        return volume
    with placed(shown):
        return volume.level(level)


class _OpenedAgain:
    """A file as other processes open it, once, for the fields that are read there."""

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments
        self.volume: Volume | None = None

    def __reduce__(self) -> Any:
        return _OpenedAgain, self.arguments

    def __call__(self, name: str) -> np.ndarray:
        if self.volume is None:
            path, fields, format, options = self.arguments
            self.volume = open_lazily(path, fields, format=format, **options)
        return self.volume.with_arrays({}).array(name)  # of which no copy stays here


def readers() -> tuple[Reader, ...]:
    """Return all readers, in the order in which they are tried."""
    return (*_foreign(), *_registered(), *READERS)


def find_reader(path: Path, format: str | None = None) -> Reader:
    """Return the reader for an existing file."""
    url = url_of(path)
    head = _head(path)
    if format is not None:
        by_name = {reader.name: reader for reader in readers()}
        if format not in by_name:
            raise unknown_name("format", format, by_name)
        return by_name[format]
    for reader in [reader for reader in READERS if reader.remote] if url else readers():
        if reader.matches(path, head):
            return reader
    raise _unknown_format(path, head)


def reader_for_suffix(path: Path) -> Reader | None:
    """Return the most general reader for a file's suffix."""
    fitting = [reader for reader in readers() if path.suffix.lower() in reader.suffixes]
    return fitting[-1] if fitting else None


def check_options(reader: Reader, options: Iterable[str]) -> None:
    """Check that the reader supports all options."""
    for option in options:
        if option not in reader.options:
            raise unknown_name(f"{reader.name} option", option, reader.options)


@functools.cache
def _registered() -> tuple[Reader, ...]:
    """Return the readers of other rooms of this package."""
    return tuple(make() for make in REGISTERED["reader"].values())


@functools.cache
def _foreign() -> tuple[Reader, ...]:
    """Return the readers of other packages; warn if one cannot be loaded."""
    result = []
    for entry in importlib.metadata.entry_points(group=GROUP):
        try:
            loaded = entry.load()
            result.append(loaded() if isinstance(loaded, type) else loaded)
        except Exception as error:
            warnings.warn(
                f"the reader {entry.name!r} ({entry.value}) cannot be loaded: {error}", stacklevel=2
            )
    return tuple(result)


def _head(path: Path) -> bytes:
    if url_of(path):
        # A store is a directory: to ask for it would be in vain.
        return b"" if path.suffix in ("", ".zarr") else head_of(path, HEAD_LENGTH)
    if path.is_dir():
        return b""
    check_readable(path)
    try:
        with builtins.open(path, "rb") as file:
            return file.read(HEAD_LENGTH)
    except FileNotFoundError:
        raise missing(path) from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error


def _unknown_format(path: Path, head: bytes) -> FileFormatError:
    by_name = reader_for_suffix(path)
    if path.is_dir():
        if lines := _openable(path):
            listed = "\n".join(lines)
            return FileFormatError(
                f"{path} is a directory that no reader knows as a whole; open what is in "
                f"it:\n{listed}"
            )
        message = f"{path} is a directory that no reader knows"
    elif not head:
        message = f"{path} is empty"
    elif head.startswith(b"MATLAB 5.0"):
        message = (
            f"{path} is a MATLAB file of a version before 7.3; save it with the option '-v7.3', or "
            "give the arrays of scipy.io.loadmat to vm.Volume"
        )
    elif by_name is not None:
        message = (
            f"{path} is named like {by_name.description}, but starts with {head[:8]!r}: it is "
            "damaged or of another kind"
        )
    else:
        message = (
            f"{path} is of a format that voluminous does not know; it starts with {head[:8]!r}"
        )
    from ..image.formats import FORMATS

    if path.is_file() and any(path.suffix.lower() in form.suffixes for form in FORMATS):
        message += "; images are opened with vm.Image.load"
    known = (r.name + (f" ({' '.join(r.suffixes)})" if r.suffixes else "") for r in readers())
    return FileFormatError(f"{message}. Known formats: {', '.join(known)}")


def _openable(directory: Path) -> list[str]:
    """Return lines that list the supported files in a directory, without trying yt (slow)."""
    quick = [reader for reader in readers() if not isinstance(reader, AnyYtReader)]
    lines = []
    with contextlib.suppress(OSError):  # no permission to read the directory
        for entry in sorted(itertools.islice(directory.iterdir(), _ENTRIES)):
            with contextlib.suppress(OSError, InputError):
                head = b"" if entry.name.startswith(".") else _head(entry)
                reader = next((reader for reader in quick if reader.matches(entry, head)), None)
                if reader is not None and not entry.name.startswith("."):
                    lines.append(f"  {entry}: {reader.description}")
    return lines[:_LISTED] + [f"  … and {len(lines) - _LISTED} more"] * (len(lines) > _LISTED)


def save(volume: Volume, path: str | Path, *, format: str | None = None, **options: Any) -> None:
    """Write a volume to a file or a directory; see `Volume.save`."""
    path = as_path(path)
    writer: Any = writer_for(path, format)
    for option in options:
        if option not in writer.write_options:
            raise unknown_name(f"{writer.name} option for writing", option, writer.write_options)
    place = new_directory if writer.writes_directory else replacing
    with place(path) as temporary, placed(path):
        writer.write(volume, temporary, **options)


def writer_for(path: Path, format: str | None = None) -> Reader:
    """Return the writer for a file name, or for a format."""
    writers = [reader for reader in readers() if getattr(reader, "writes", False)]
    if format is not None:
        named = {reader.name: reader for reader in writers}
        if format not in named:
            raise unknown_name("format that can be written", format, named)
        return named[format]
    known: dict[str, Reader] = {}
    for reader in writers:
        for suffix in getattr(reader, "write_suffixes", ()) or reader.suffixes:
            known.setdefault(suffix, reader)  # the first with this suffix, as for reading
    fitting = [suffix for suffix in known if path.name.lower().endswith(suffix)]
    if not fitting:
        raise unknown_name("volume format", path.suffix, known)
    return known[max(fitting, key=len)]
