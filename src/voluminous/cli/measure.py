"""Measure totals in a scene or a data file: mass, momentum and energy, from any side."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, UnitsError, unknown_name
from ..files import replacing
from .common import say
from .data import add_reading_options, assignment, data_file

if TYPE_CHECKING:
    from astropy.table import QTable

    from ..cameras import Camera
    from ..measuring import Measurement
    from ..regions import Region
    from ..volume import Volume


# "name = value", but not a comparison (==), which is an expression without a name.
_NAMED = re.compile(r"\s*([A-Za-z_]\w*)\s*=(?!=)(.*)", re.DOTALL)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "file",
        type=Path,
        metavar="FILE",
        help="file with data, scene file (TOML), or an image that was rendered from one",
    )
    parser.add_argument(
        "--quantity",
        action="append",
        default=[],
        metavar="NAME=EXPR",
        help="what to add up over all cells times their volumes, such as "
        "momentum=\"density * los('velocity')\"; may be given several times; the density by "
        "default",
    )
    parser.add_argument(
        "--where",
        metavar="COND",
        help="only cells in which this holds, such as \"los('velocity') > 5 km/s\"",
    )
    parser.add_argument(
        "--region",
        metavar="SHAPE",
        help='only this part of space, such as "sphere((0, 0, 0), 100 AU)": box(low, high), '
        "sphere(center, radius), cylinder(start, end, radius), cone or doublecone(apex, axis, "
        "opening, height), combined by & | ~ or and, or, not; lengths without a unit are in that "
        "of the data",
    )
    parser.add_argument(
        "--aperture",
        metavar="SHAPE",
        help='only what is seen in this part of the image: "circle((0, 0), 0.1 pc)", '
        "rectangle(low, high) or polygon(point, point, ...), from the middle of the data",
    )
    parser.add_argument(
        "--angles",
        nargs="+",
        action="extend",
        metavar="INCL,PHI",
        help="from where it is seen, in degrees, for los(…) and --aperture: one row for each "
        "(--angles=-30,0 for one that begins with a minus); a scene's own camera by default",
    )
    parser.add_argument(
        "--unit",
        action="append",
        default=[],
        metavar="NAME=UNIT",
        help="unit of a total, such as mass=Msun",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="table to write (.ecsv, .csv, .fits)"
    )
    add_reading_options(parser)
    parser.add_argument("-q", "--quiet", action="store_true", help="say nothing but errors")


def run(args: argparse.Namespace) -> int:
    """Measure, print and save."""
    if args.output is not None:
        check_table(args.output)
    region = _region(args.region)
    asked = _quantities(args.quantity)
    units = dict(_named(text, "--unit", "mass=Msun") for text in args.unit)
    volume, camera = _opened(args, asked)
    asked = asked or _density(volume)
    cameras = _cameras(args, volume) or ([] if camera is None else [camera])
    table = _measured(volume, asked, args, cameras, region)
    table = with_units(table if cameras else one_row(table), units, list(asked))
    say(args.quiet, text_of(table))
    if args.output is not None:
        write_table(table, args.output)
        say(args.quiet, f"{args.output}: {len(table)} row{'s' * (len(table) != 1)}")
    return 0


def _quantities(given: Iterable[str]) -> dict[str, str]:
    """Return name → expression; an unnamed expression is its own name."""
    found: dict[str, str] = {}
    for text in given:
        match = _NAMED.fullmatch(text)
        name, expression = (match[1], match[2].strip()) if match else (text.strip(), text.strip())
        if name in found:
            raise InputError(f"--quantity names {name!r} twice")
        if not expression:
            raise InputError(f"--quantity expects NAME=EXPR such as mass=density, got {text!r}")
        found[name] = expression
    return found


def _region(text: str | None) -> Region | None:
    from ..measuring.shapes import region_of

    return None if text is None else region_of(text)


def _named(text: str, option: str, example: str) -> tuple[str, str]:
    """Return both sides of ``mass=Msun``."""
    name, equals, value = text.partition("=")
    if not equals or not name.strip() or not value.strip():
        raise InputError(f"{option} expects something like {example}, got {text!r}")
    return name.strip(), value.strip()


def _opened(args: argparse.Namespace, asked: dict[str, str]) -> tuple[Volume, Camera | None]:
    from ..scene import Scene
    from .data import is_volume, opened

    if is_volume(args.file, args.format):
        joined = " + ".join(f"({expression})" for expression in asked.values())
        return opened(data_file(args.file, args), joined or None).volume, None
    scene = Scene.load(args.file)
    changes = dict(assignment(text, "camera.incl=40") for text in args.set)
    scene = scene.replaced(changes) if changes else scene
    return scene.volume(), scene.camera


def _density(volume: Volume) -> dict[str, str]:
    from .data import first_field

    name = first_field(volume)
    if name is None:
        raise InputError("the volume has no fields to measure; say what with --quantity NAME=EXPR")
    return {name: name}


def _cameras(args: argparse.Namespace, volume: Volume) -> list[Camera]:
    from ..cameras import Orthographic

    frame = {} if args.aperture is None else _framed(args.aperture, volume)
    cameras: list[Camera] = []
    for text in args.angles or ():
        try:
            incl, phi = (float(word) for word in text.split(","))
        except ValueError:
            raise InputError(
                f"--angles expects INCL,PHI in degrees such as 60,30, got {text!r}"
            ) from None
        cameras.append(Orthographic(incl, phi, **frame))
    return cameras


def _framed(aperture: str, volume: Volume) -> dict[str, Any]:
    from ..measuring.shapes import polygon_of

    corners = polygon_of(aperture, volume.unit)
    low, high = corners.min(axis=0), corners.max(axis=0)
    if not (low < high).all():
        raise InputError(f"--aperture {aperture!r} has no area")
    return {"width": tuple(high - low), "shift": tuple(0.5 * (low + high))}


def _measured(
    volume: Volume,
    asked: dict[str, str],
    args: argparse.Namespace,
    cameras: list[Camera],
    region: Region | None,
) -> Any:
    """Return a table with one row per camera; without cameras, a single measurement."""
    from ..measuring import measure

    texts = [*asked.values(), args.where or ""]
    if not cameras and any(re.search(r"\blos\s*\(", text) for text in texts):
        raise InputError("los(…) depends on from where it is seen: give --angles INCL,PHI")
    if not cameras and args.aperture is not None:
        raise InputError("--aperture is a part of the image: give --angles INCL,PHI")
    parts = {"region": region, "aperture": args.aperture}
    return measure(volume, asked, args.where, cameras or None, **parts)


_FORMATS = {".ecsv": "ascii.ecsv", ".csv": "ascii.csv", ".fits": "fits"}


def check_table(path: Path) -> None:
    """Raise before any work if the table cannot be written."""
    if path.suffix.lower() not in _FORMATS:
        raise InputError(f"a table is written as {', '.join(_FORMATS)}, got {path}")
    if not path.resolve().parent.is_dir():
        raise InputError(f"the directory {path.parent} does not exist; create it first")


def one_row(found: Measurement) -> QTable:
    """Return a measurement as a table."""
    from astropy import units as u
    from astropy.table import QTable

    values: dict[str, Any] = {**found.totals, "volume": found.volume}
    table = QTable({name: u.Quantity([value]) for name, value in values.items()})
    table["cells"] = [found.cells]
    return table


def with_units(table: QTable, units: Mapping[str, str], totals: Sequence[str]) -> QTable:
    """Convert columns to the requested units."""
    from ..units import parse_unit, unit_name

    known = [*totals, "volume"]
    for name, unit in units.items():
        if name not in known:
            raise unknown_name("total", name, known)
        own = table[name].unit
        try:
            table[name] = table[name].to(parse_unit(unit))
        except (ValueError, TypeError) as error:
            raise UnitsError(f"{name} is in {unit_name(own) or 'no unit'}, not {unit}") from error
    return table


def text_of(table: QTable) -> str:
    """Return a table as text, with units below the names."""
    shown = table.copy()
    for name in shown.colnames:
        if shown[name].dtype.kind == "f":
            shown[name].info.format = ".8g"
    return "\n".join(shown.pformat(max_lines=-1, max_width=-1, show_unit=True))


def write_table(table: QTable, path: Path) -> None:
    """Write a table; CSV has no units, so they are appended to the column names."""
    from ..units import unit_name

    form = _FORMATS[path.suffix.lower()]
    if form == "ascii.csv":
        table = table.copy()
        for name in table.colnames:
            unit = unit_name(getattr(table[name], "unit", None))
            if unit:
                table.rename_column(name, f"{name} [{unit}]")
    with replacing(path) as temporary:
        table.write(temporary, format=form, overwrite=True)
