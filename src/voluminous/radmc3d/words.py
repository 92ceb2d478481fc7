"""RADMC-3D's words on the command line: from a list of them to a `Request`.

The words are those of the manual's chapters on images, spectra and command-line options
(RADMC-3D 2.0, Dullemond et al. 2012, ascl:1202.015).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import InputError, unknown_name

# RADMC-3D's own lengths in cm; apertures have another astronomical unit (1.49598e13).
AU, PARSEC = 1.496e13, 3.08572e18
LIGHT = 2.9979245800e10
# Of a line without a width, and of a width or a range without a number of channels.
_WIDTH, _CHANNELS, _RANGE = 10.0, 40, 100
# RADMC-3D's depth of sub-pixels means "as many as needed" from here on.
DEEP = 12

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]


@dataclass(frozen=True)
class Request:
    """What the words ask for. None stands for what the model's ``radmc3d.inp`` says.

    Lengths are in cm, angles in degrees, sizes for a local observer in radians, wavelengths in
    micron, velocities in km/s.
    """

    #: "image", "spectrum" or "tausurf".
    command: str = ""
    #: Optical depth of the surface, for "tausurf".
    depth: float = 1.0
    #: "intensity", "tau" or "column".
    quantity: str | None = None
    wavelength: float | None = None
    wavelength_range: tuple[float, float] | None = None
    nlam: int | None = None
    #: Number of a point of ``wavelength_micron.inp``, from 1.
    ilambda: int | None = None
    #: "loadlambda": the camera's wavelengths are in a file; "color": numbers of global ones are.
    load: str | None = None
    #: All wavelengths of ``wavelength_micron.inp``.
    all_wavelengths: bool = False
    iline: int | None = None
    imolspec: int | None = None
    linenlam: int = 1
    widthkms: float = 0.0
    vkms: float = 0.0
    incl: float = 0.0
    phi: float = 0.0
    posang: float = 0.0
    nx: int = 100
    ny: int = 100
    half_size: tuple[float, float] | None = None
    #: Where the middle of the frame is in the image plane.
    middle: tuple[float, float] = (0.0, 0.0)
    #: Left, right, lower and upper edge.
    zoom: Four | None = None
    truepix: bool = False
    truezoom: bool = False
    point: Three = (0.0, 0.0, 0.0)
    local: bool = False
    observer: Three | None = None
    projection: int | None = None
    zenith: float | None = None
    #: How often pixels may be halved; below 1 never.
    refine: int | None = None
    second: bool = False
    #: Doppler catching, which is of second order.
    catching: bool = False
    stars: bool | None = None
    dust: bool | None = None
    lines: bool | None = None
    freefree: bool | None = None
    #: False: light is not scattered, and what scatters does not dim.
    scattering: bool | None = None
    #: False: light is not scattered, but what scatters dims.
    scattered: bool | None = None
    circular: bool = False
    aperture: bool = False
    #: Distance of the observer in parsec, for apertures.
    dpc: float | None = None
    binary: bool | None = None

    @property
    def channels(self) -> str:
        """The method by which channels are chosen: the word that begins it."""
        methods = {
            "lambda": self.wavelength is not None,
            "lambdarange": self.wavelength_range is not None,
            "ilambda": self.ilambda is not None,
            "iline": (self.iline or self.imolspec) is not None and self.lines is not False,
            self.load or "": self.load is not None,
            "sed" if self.command == "spectrum" else "allwl": self.all_wavelengths,
        }
        chosen = [word for word, given in methods.items() if given]
        if len(chosen) > 1:
            raise InputError(
                f"{' and '.join(chosen)} choose channels in {len(chosen)} ways; give one of them"
            )
        if not chosen and self.quantity == "column":
            return "lambda"  # the column is the same at any wavelength
        if not chosen:
            raise InputError(
                "no word chooses channels; give lambda, lambdarange, ilambda, iline, loadlambda, "
                "color or allwl (sed has those of wavelength_micron.inp)"
            )
        return chosen[0]


Change = Callable[..., dict[str, Any]]


def _length(unit: float, name: str) -> dict[str, tuple[str, Change]]:
    return {
        f"size{name}": ("x", lambda s: {"half_size": (unit * s / 2,) * 2, "local": False}),
        f"zoom{name}": ("xxxx", lambda *z: {"zoom": _times(unit, z), "local": False}),
        f"point{name}": ("xxx", lambda *p: {"point": _times(unit, p)}),
        f"locobs{name}": ("xxx", lambda *p: {"observer": _times(unit, p), "local": True}),
    }


def _times(unit: float, numbers: Sequence[float]) -> tuple[float, ...]:
    return tuple(unit * number for number in numbers)


def _flags(name: str, on: str, off: str) -> dict[str, tuple[str, Change]]:
    return {on: ("", lambda: {name: True}), off: ("", lambda: {name: False})}


# Word → what follows it (x: a number, n: a whole number), and what it changes in a `Request`.
WORDS: dict[str, tuple[str, Change]] = {
    "lambda": ("x", lambda x: {"wavelength": x}),
    "nuhz": ("x", lambda x: {"wavelength": 1e4 * LIGHT / x}),
    "lambdarange": ("xx", lambda a, b: {"wavelength_range": (a, b)}),
    "nlam": ("n", lambda n: {"nlam": n}),
    "ilambda": ("n", lambda n: {"ilambda": n}),
    "loadlambda": ("", lambda: {"load": "loadlambda"}),
    "color": ("", lambda: {"load": "color"}),
    "allwl": ("", lambda: {"all_wavelengths": True}),
    "iline": ("n", lambda n: {"iline": n, "lines": True}),
    "imolspec": ("n", lambda n: {"imolspec": n, "lines": True}),
    "linenlam": ("n", lambda n: {"linenlam": n}),
    "widthkms": ("x", lambda x: {"widthkms": x}),
    "vkms": ("x", lambda x: {"vkms": x}),
    "incl": ("x", lambda x: {"incl": x, "local": False}),
    "phi": ("x", lambda x: {"phi": x, "local": False}),
    "posang": ("x", lambda x: {"posang": x}),
    "npix": ("n", lambda n: {"nx": n, "ny": n}),
    "npixx": ("n", lambda n: {"nx": n}),
    "npixy": ("n", lambda n: {"ny": n}),
    **_length(AU, "au"),
    **_length(PARSEC, "pc"),
    "sizeradian": ("x", lambda s: {"half_size": (s / 2, s / 2), "local": True}),
    "zoomradian": ("xxxx", lambda *z: {"zoom": z, "local": True}),
    "truepix": ("", lambda: {"truepix": True}),
    "truezoom": ("", lambda: {"truezoom": True}),
    "projection": ("n", lambda n: {"projection": n}),
    "zenith": ("x", lambda x: {"zenith": x}),
    "nrrefine": ("n", lambda n: {"refine": n}),
    "fluxcons": ("", lambda: {"refine": 100}),
    "nofluxcons": ("", lambda: {"refine": -1}),
    "secondorder": ("", lambda: {"second": True}),
    "doppcatch": ("", lambda: {"second": True, "catching": True}),
    "tracetau": ("", lambda: {"quantity": "tau"}),
    "tracecolumn": ("", lambda: {"quantity": "column"}),
    "tracenormal": ("", lambda: {"quantity": "intensity"}),
    **_flags("stars", "inclstar", "nostar"),
    **_flags("dust", "incldust", "nodust"),
    **_flags("lines", "inclline", "noline"),
    **_flags("freefree", "inclfreefree", "nofreefree"),
    **_flags("freefree", "inclgascont", "nogascont"),
    **_flags("scattering", "inclscat", "noscat"),
    "maxnrscat": ("n", lambda n: {"scattered": n != 0}),
    **_flags("aperture", "useapert", "noapert"),
    **_flags("binary", "imageunform", "imageformatted"),
    "dpc": ("x", lambda x: {"dpc": x}),
    "circ": ("", lambda: {"circular": True}),
    # Of no consequence here: threads, Monte Carlo, levels that no chosen line has.
    **{word: ("n", lambda n: {}) for word in ("setthreads", "countwrite")},
    **{f"nphot_{kind}": ("n", lambda n: {}) for kind in ("therm", "scat", "spec", "mono")},
    **dict.fromkeys(("nostokes", "autosubset", "noautosubset", "resetseed"), ("", dict)),
}
COMMANDS: dict[str, tuple[str, Change]] = {
    "image": ("", lambda: {"command": "image"}),
    "spectrum": ("", lambda: {"command": "spectrum"}),
    "sed": ("", lambda: {"command": "spectrum", "all_wavelengths": True}),
    "tausurf": ("x", lambda x: {"command": "tausurf", "depth": x}),
}
# Other words of RADMC-3D's for the same: its manual's, and those its source has besides.
_ALIASES = {
    "theta": "incl",
    "inu": "ilambda",
    "globalfreq": "allwl",
    "globallam": "allwl",
    "loadcolor": "color",
    "linenfreq": "linenlam",
    "second": "secondorder",
    "dcatch": "doppcatch",
    "dopplercatch": "doppcatch",
    "norefine": "nofluxcons",
    "apert": "useapert",
    "circular": "circ",
    "imageunformatted": "imageunform",
    "writeimage_unformatted": "imageunform",
}
_MONTE_CARLO = "needs Monte Carlo, which voluminous does not have; run radmc3d for it"
_FILES = "writes files about a model; vm.open reads the model, and volume.save writes it"
# Words of RADMC-3D's that are refused, and why.
_REFUSED = {
    **dict.fromkeys(("mctherm", "mcmono", "selectscat", "lambdasinglescat"), _MONTE_CARLO),
    **dict.fromkeys(("simplescat", "writescatsrc"), _MONTE_CARLO),
    "stokes": "asks for polarization, which comes from scattering: it " + _MONTE_CARLO,
    "movie": "is made with vm.movie",
    "linelist": "lists lines; vm.Molecule.open has their frequencies",
    "lineinfo": "writes about lines; vm.Molecule.open has their frequencies",
    **dict.fromkeys(("writemodel", "writegridfile", "writepop", "calcpop", "usetree"), _FILES),
    "myaction": "is of a user's own module of RADMC-3D",
    "child": "makes RADMC-3D wait for commands; in Python vm.observe draws picture after picture",
    "sloppy": "changes RADMC-3D's rule for sub-pixels, which is used here as it is",
    "diag_subpix": "writes sub-pixels to a file, which voluminous does not",
}


def request_of(words: Sequence[str]) -> Request:
    """Return what RADMC-3D's words ask for.

    Parameters
    ----------
    words : sequence of str
        Such as ``["image", "lambda", "870", "incl", "60"]``. As in RADMC-3D a later word overrides
        an earlier one.

    Raises
    ------
    UnknownNameError
        For a word that RADMC-3D does not have; names the nearest.
    InputError
        For a word that needs Monte Carlo, or without its numbers; if there is not one command; if
        sizes cannot be those of a picture, or channels are chosen in two ways or none.

    Examples
    --------
    >>> request = request_of("image iline 2 widthkms 5 incl 60".split())
    >>> request.channels, request.linenlam, request.incl
    ('iline', 40, 60.0)
    """
    request, commands, rest = Request(), [], list(words)
    while rest:
        given = rest.pop(0)
        word = _ALIASES.get(given, given)
        _refuse(word)
        if word in COMMANDS:
            commands.append(word)
        kinds, change = {**WORDS, **COMMANDS}[word]
        if len(rest) < len(kinds):
            raise InputError(
                f"{given} is followed by {len(kinds)} number{'s' * (len(kinds) > 1)}, "
                f"but {len(rest) or 'nothing'} {'come' if len(rest) > 1 else 'comes'} after it"
            )
        numbers = [_number(given, kind, rest.pop(0)) for kind in kinds]
        if given == "nuhz" and numbers[0] <= 0.0:
            raise InputError(f"nuhz must be positive, got {numbers[0]}")
        request = _line_defaults(word, dataclasses.replace(request, **change(*numbers)))
    if len(commands) != 1:
        listed = ", ".join(COMMANDS)
        raise InputError(
            f"give one of the commands {listed}; got {' and '.join(commands) or 'none'}"
        )
    request = _framed(request)
    _check(request)
    return request


def _refuse(word: str) -> None:
    if word in WORDS or word in COMMANDS:
        return
    if word in _REFUSED:
        raise InputError(f"{word} {_REFUSED[word]}")
    if word.startswith(("subbox_", "vtk_", "sample_", "sample-")):
        raise InputError(f"{word} {_FILES}")
    if word.startswith("-"):
        raise InputError(f"the option {word} comes before RADMC-3D's words")
    raise unknown_name("word", word, [*WORDS, *COMMANDS, *_ALIASES])


def _number(word: str, kind: str, text: str) -> Any:
    """Return a number as Fortran reads it: 6. and 1d-3 are numbers."""
    try:
        value = float(text.lower().replace("d", "e"))
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or (kind == "n" and value != int(value)):
        which = "a whole number" if kind == "n" else "a number"
        raise InputError(f"{word} expects {which}, got {text!r}")
    return int(value) if kind == "n" else value


def _line_defaults(word: str, request: Request) -> Request:
    if word == "linenlam" and request.linenlam > 1 and request.widthkms == 0.0:
        return dataclasses.replace(request, widthkms=_WIDTH)
    if word == "widthkms" and request.linenlam == 1:
        return dataclasses.replace(request, linenlam=_CHANNELS)
    if word == "lambdarange" and request.nlam is None:
        return dataclasses.replace(request, nlam=_RANGE)
    return request


def _framed(request: Request) -> Request:
    if request.zoom is None:
        return request
    left, right, low, high = request.zoom
    if right <= left or high <= low:
        raise InputError(
            "a zoom has the left, right, lower and upper edge, in that order; "
            f"got {left:g}, {right:g}, {low:g}, {high:g}"
        )
    half = [0.5 * (right - left), 0.5 * (high - low)]
    count = [request.nx, request.ny]
    if not request.truepix:
        sides = [2.0 * h / n for h, n in zip(half, count, strict=True)]
        wide = 0 if sides[0] > sides[1] else 1
        narrow, side = 1 - wide, sides[wide]
        if sides[narrow] < side:
            count[narrow] = max(1, math.floor(2.0 * half[narrow] / side))
            if count[narrow] > 1 and not request.truezoom:
                half[narrow] = 0.5 * (count[narrow] * side)
    return dataclasses.replace(
        request,
        nx=count[0],
        ny=count[1],
        half_size=(half[0], half[1]),
        middle=(0.5 * (right + left), 0.5 * (high + low)),
    )


def _check(request: Request) -> None:
    positive = {
        "npix": min(request.nx, request.ny),
        "linenlam": request.linenlam,
        "nlam": 1 if request.nlam is None else request.nlam,
        "lambda": 1.0 if request.wavelength is None else request.wavelength,
        "lambdarange": min(request.wavelength_range or (1.0,)),
        "ilambda": 1 if request.ilambda is None else request.ilambda,
        "iline": 1 if request.iline is None else request.iline,
        "imolspec": 1 if request.imolspec is None else request.imolspec,
        "the size": min(request.half_size or (1.0,)),
        "dpc": 1.0 if request.dpc is None else request.dpc,
    }
    for word, value in positive.items():
        if value <= 0:
            raise InputError(f"{word} must be positive, got {value}")
    if request.nlam is not None and request.wavelength_range is None:
        raise InputError("nlam is the number of wavelengths of lambdarange; give that too")
    if request.projection not in (None, 1, 2):
        raise InputError(f"projection is 1 (flat) or 2 (dome), got {request.projection}")
    if request.scattering or request.scattered:
        raise InputError(f"light that is scattered {_MONTE_CARLO}, or give noscat")
    if request.local and request.observer is None:
        raise InputError(
            "a size in radians is for a local observer; say where it is: locobsau x y z"
        )
    if request.local and request.half_size is None:
        raise InputError("a local observer's picture needs its size: sizeradian")
    if request.local and request.command == "spectrum":
        raise InputError("spectra are of an observer at infinity; leave out locobs… and sizeradian")
    if request.aperture and request.dpc is None:
        raise InputError("useapert needs the distance of the observer: dpc, in parsec")
    if request.aperture and request.command != "spectrum":
        raise InputError("useapert is for spectra")
    if request.circular and request.command != "spectrum":
        raise InputError("circ is for spectra; voluminous writes no circimage.out")
    if request.circular and request.aperture:
        raise InputError("give circ or useapert: a circular spectrum has no aperture")
    if request.command == "spectrum" and request.quantity in ("tau", "column"):
        raise InputError("tracetau and tracecolumn are for images")
    assert request.channels
