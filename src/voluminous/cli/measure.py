"""Measure totals in a scene or a data file: mass, momentum and energy, from any side."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, UnitsError, check_name
from ..files import replacing
from .common import add_quiet, add_several, assignment, check_directory, say, settings
from .data import add_reading_options, data_file, first_field, is_volume, opened

if TYPE_CHECKING:
    from astropy.table import QTable

    from ..cameras import Camera
    from ..volume import Volume

# "name = value", but not a comparison (==), which is an expression without a name.
_NAMED = re.compile(r"\s*([A-Za-z_]\w*)\s*=(?!=)(.*)", re.DOTALL)
_FORMATS = {".ecsv": "ascii.ecsv", ".csv": "ascii.csv", ".fits": "fits"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    help = "file with data, scene file (TOML), or an image that was rendered from one"
    parser.add_argument("file", type=Path, metavar="FILE", help=help)
    help = (
        "what to add up over all cells times their volumes, such as "
        "momentum=\"density * los('velocity')\"; may be given several times; the density by "
        "default"
    )
    add_several(parser, "--quantity", "NAME=EXPR", help)
    help = "only cells in which this holds, such as \"los('velocity') > 5 km/s\""
    parser.add_argument("--where", metavar="COND", help=help)
    parser.add_argument(
        "--clip",
        metavar="SHAPE",
        help='only this part of space, such as "sphere((0, 0, 0), 100 AU)": box(low, high), '
        "sphere(center, radius), halfspace(point, normal), cylinder(start, end, radius), cone or "
        "doublecone(apex, axis, opening, height), combined by & | ~ or and, or, not; lengths "
        "without a unit are in that of the data",
    )
    parser.add_argument(
        "--aperture",
        metavar="SHAPE",
        help='only what is seen in this part of the image: "circle((0, 0), 0.1 pc)", '
        "rectangle(low, high) or polygon(point, point, ...), from the middle of the data",
    )
    help = (
        "from where it is seen, in degrees, for los(…) and --aperture: one row for each "
        "(--angles=-30,0 for one that begins with a minus); a scene's own camera by default"
    )
    add_several(parser, "--angles", "INCL,PHI", help, nargs="+", action="extend")
    add_several(parser, "--unit", "NAME=UNIT", "unit of a total, such as mass=Msun")
    help = "what measuring may take, such as 2GiB: the data are read and measured chunk by chunk"
    parser.add_argument("--memory", metavar="BYTES", help=help)
    help = "table to write (.ecsv, .csv, .fits)"
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help=help)
    add_reading_options(parser)
    add_quiet(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print and save."""
    from ..measuring import measure
    from ..regions import region_of

    if args.output is not None and args.output.suffix.lower() not in _FORMATS:
        raise InputError(f"a table is written as {', '.join(_FORMATS)}, got {args.output}")
    if args.output is not None:
        check_directory(args.output)
    clip = None if args.clip is None else region_of(args.clip)
    quantities = _quantities(args.quantity)
    units = dict(assignment(text, "--unit", "something like mass=Msun") for text in args.unit)
    volume, camera = _opened(args, quantities)
    name = first_field(volume) if not quantities else ""
    if name is None:
        raise InputError("the volume has no fields to measure; say what with --quantity NAME=EXPR")
    quantities = quantities or {name: name}
    cameras = _cameras(args, volume) or ([] if camera is None else [camera])
    texts = [*quantities.values(), args.where or ""]
    if not cameras and any(re.search(r"\blos\s*\(", text) for text in texts):
        raise InputError("los(…) depends on from where it is seen: give --angles INCL,PHI")
    if not cameras and args.aperture is not None:
        raise InputError("--aperture is a part of the image: give --angles INCL,PHI")
    parts = {"clip": clip, "aperture": args.aperture, "memory": args.memory}
    result: Any = measure(volume, quantities, args.where, cameras or None, **parts)
    table = _with_units(result if cameras else _one_row(result), units, [*quantities, "volume"])
    say(args.quiet, _text(table))
    if args.output is not None:
        _write(table, args.output)
        say(args.quiet, f"{args.output}: {len(table)} row{'s' * (len(table) != 1)}")
    return 0


def _quantities(given: list[str]) -> dict[str, str]:
    """Return name → expression; an unnamed expression is its own name."""
    result: dict[str, str] = {}
    for text in given:
        match = _NAMED.fullmatch(text)
        name, expression = (match[1], match[2].strip()) if match else (text.strip(), text.strip())
        if name in result:
            raise InputError(f"--quantity names {name!r} twice")
        if not expression:
            raise InputError(f"--quantity expects NAME=EXPR such as mass=density, got {text!r}")
        result[name] = expression
    return result


def _opened(args: argparse.Namespace, quantities: dict[str, str]) -> tuple[Volume, Camera | None]:
    from ..scene import Scene

    if is_volume(args.file, args.format):
        joined = " + ".join(f"({expression})" for expression in quantities.values())
        return opened(data_file(args.file, args), joined or None)[0], None
    scene = Scene.load(args.file)
    changes = settings(args.set, "camera.incl=40")
    scene = scene.replaced(changes) if changes else scene
    return scene.volume(), scene.camera


def _cameras(args: argparse.Namespace, volume: Volume) -> list[Camera]:
    from ..cameras import Orthographic
    from ..measuring.shapes import polygon_of

    frame: dict[str, Any] = {}
    if args.aperture is not None:
        corners = polygon_of(args.aperture, volume.unit)
        low, high = corners.min(axis=0), corners.max(axis=0)
        if not (low < high).all():
            raise InputError(f"--aperture {args.aperture!r} has no area")
        frame = {"width": tuple(high - low), "shift": tuple(0.5 * (low + high))}
    cameras: list[Camera] = []
    for text in args.angles:
        try:
            incl, phi = (float(word) for word in text.split(","))
        except ValueError:
            raise InputError(
                f"--angles expects INCL,PHI in degrees such as 60,30, got {text!r}"
            ) from None
        cameras.append(Orthographic(incl, phi, **frame))
    return cameras


def _one_row(result: Any) -> QTable:
    from astropy import units as u
    from astropy.table import QTable

    values: dict[str, Any] = {**result.totals, "volume": result.volume}
    table = QTable({name: u.Quantity([value]) for name, value in values.items()})
    table["cells"] = [result.cells]
    return table


def _with_units(table: QTable, units: dict[str, str], columns: list[str]) -> QTable:
    from ..units import parse_unit, unit_name

    for name, unit in units.items():
        check_name("total", name, columns)
        present = table[name].unit
        try:
            table[name] = table[name].to(parse_unit(unit))
        except (ValueError, TypeError) as error:
            raise UnitsError(
                f"{name} is in {unit_name(present) or 'no unit'}, not {unit}"
            ) from error
    return table


def _text(table: QTable) -> str:
    shown = table.copy()
    for name in shown.colnames:
        if shown[name].dtype.kind == "f":
            shown[name].info.format = ".8g"
    return "\n".join(shown.pformat(max_lines=-1, max_width=-1, show_unit=True))


def _write(table: QTable, path: Path) -> None:
    """Write a table; CSV has no units, so they are appended to the column names."""
    from ..units import unit_name, unit_of

    table = table.copy()
    for name in table.colnames if path.suffix.lower() == ".csv" else ():
        if unit := unit_name(unit_of(table[name])):
            table.rename_column(name, f"{name} [{unit}]")
    with replacing(path) as temporary:
        table.write(temporary, format=_FORMATS[path.suffix.lower()], overwrite=True)
