"""`spectrum`: the flux of a volume at frequencies, through an aperture or of all of it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..cameras import Orthographic
from ..errors import InputError
from ..geometry import CARTESIAN
from ..grids.arguments import on_grid
from ..grids.structured import is_structured
from ..grids.trees.cells import TreeCells
from ..image.spectrum import Spectrum
from ..objects import SceneObject, Stars
from ..progress import Progress, with_progress
from ..units import as_given, is_listed, parse_unit, plain, radians
from .cells import JANSKY, beside_cells, warn_of_scattering
from .cubes import check_arguments, observe, tuned
from .light import check_distance, model_background, scene_objects
from .rings import Rings

if TYPE_CHECKING:
    from ..grids.contract import Grid
    from ..image.cube import Cube
    from ..media import Medium
    from ..volume import Volume

# Pixels across the first picture, or half as many rings and azimuths; and the most of them.
_FIRST, _FINEST = 64, 1024
# How a frame around a volume is turned. Along the edges of a box rows of pixels are inside or not;
# at the angle of the golden ratio a box face-on changes by 7e-5 from 128 to 256 pixels, not 6e-3.
_TURNED = math.degrees(math.atan(0.5 * (math.sqrt(5.0) - 1.0)))
# Fluxes in the wings of a line, as a part of the largest, from which on the tolerance is relative.
_WINGS = 1e-2
# Rings within the innermost wall of a grid.
_INNER_RINGS = 8


@with_progress
def spectrum(
    volume: Volume,
    medium: Medium,
    camera: Any = None,
    *,
    incl: Any = None,
    phi: Any = None,
    wavelengths: Any = None,
    frequencies: Any = None,
    velocities: Any = None,
    aperture: Any = None,
    distance: Any = None,
    tolerance: float | None = 1e-3,
    antialias: str | None = None,
    objects: Any = None,
    progress: Progress = None,
    **options: Any,
) -> Spectrum:
    """Return the flux of a volume at frequencies: its spectrum, or spectral energy distribution.

    Parameters
    ----------
    volume, medium, wavelengths, frequencies, velocities
        As in `observe`.
    camera : Orthographic, optional
        The flux is that of this picture. Default: of the whole volume, or the aperture.
    incl, phi : float or Quantity, optional
        Instead of a camera, as in `Orthographic`. Default: 0.
    aperture : Quantity, optional
        Radius of a circle around the volume's centre (of spherical grids the origin): an angle, for
        which the distance is needed, or a length.
    distance : Quantity
        Of the observer, such as ``140 * u.pc``: without it there is no flux.
    tolerance : float or None
        Error allowed in each flux: the picture is drawn again with more pixels, until fluxes change
        by no more than this fraction (of velocities, of a hundredth of the largest at least: wings
        of lines come from few places); and as in `observe`. None: once.
    antialias : {None, "adaptive", "radmc3d"}
        Given, one picture is drawn, with rays as in `render`; with ``"radmc3d"`` pixels have parts
        no wider than the cells. Default: as the tolerance needs it.
    objects : sequence of SceneObject, optional
        As in `observe`; of an aperture and of rings points only (stars with luminosities).
    progress : bool or callable, optional
        As in `render`.
    **options
        Those of `observe`: ``scheme``, ``constants``, ``precision``, ``background`` …

    Returns
    -------
    Spectrum
        Flux densities in Jy, as `Cube.total` has them: intensity times solid angle, summed.

    Warns
    -----
    UserWarning
        If the finest picture does not keep the tolerance; it says by how much fluxes changed. And
        as in `observe`.

    Raises
    ------
    InputError, UnitsError
        As in `observe`; if there is no distance, the camera is not at infinity, or angles are given
        besides it.

    Notes
    -----
    Without a camera, spherical and cylindrical volumes and apertures are drawn on rings around
    their centre, which follow the radial walls of the grid; others in a frame around the volume.

    Examples
    --------
    >>> import voluminous as vm
    >>> from astropy import units as u
    >>> core = vm.models.prestellar_core(16)
    >>> dust = vm.Dust("density * 2e-26 g", 15.0, vm.Opacity.power_law(3.5, 870.0, 1.8))
    >>> sed = vm.spectrum(core, dust, wavelengths=[350, 870] * u.micron, distance=140 * u.pc)
    """
    given = {"wavelengths": wavelengths, "frequencies": frequencies, "velocities": velocities}
    quiet = options.pop("_quiet", False)
    check_arguments("spectrum", volume, medium, set(options) - {"constants"})
    check_distance(distance, volume)
    if distance is None:
        raise InputError(
            "a flux needs the distance of the observer: distance=140 * u.pc; intensities, which "
            "need none, are those of vm.observe"
        )
    away = _distance(distance)
    if camera is None:
        tilt, turn = (0.0 if angle is None else angle for angle in (incl, phi))
        camera = _first_camera(volume, tilt, turn, aperture, away)
    elif incl is not None or phi is not None:
        raise InputError(
            f"give a camera, which has its angles, or incl= and phi=; got both: {camera!r} and "
            f"incl={incl!r}, phi={phi!r}"
        )
    elif aperture is not None or not isinstance(camera, Orthographic):
        raise InputError(
            "a spectrum is of a circle (aperture=) or of the picture of a vm.Orthographic; give "
            f"one of them, got {type(camera).__name__}"
        )
    things = scene_objects(objects, volume)
    options |= {"tolerance": tolerance, "progress": progress, **given}
    options |= {"distance": away, "_quiet": True}
    cubes: list[Cube] = []
    stars = np.zeros(1)
    if isinstance(camera, Rings):
        stars = _flux_of_points(volume, medium, camera, things, options)
        things = []

    def flux(view: Any, method: str | None) -> np.ndarray:
        cube = observe(volume, medium, view, antialias=method, objects=things, **options)
        cubes[:] = [cube]
        light = cube.intensity.astype(np.float64) * _areas(view, cube)
        return np.asarray(light.sum(axis=(0, 1)))

    if antialias is not None or tolerance is None:
        total = flux(camera, antialias)
    else:
        least = 0.0 if velocities is None else _WINGS
        total = _converged(flux, camera, _method(volume, camera), tolerance, least)
    centimetres = 1.0 if volume.unit is None else float(volume.unit.to("cm"))
    (cube,) = cubes
    extra: dict[str, Any] = {}
    if not quiet:
        how = {"frequencies": cube.spectral.frequencies}
        bright = tuned(volume, medium, constants=options.get("constants", "codata"), **how)
        warn_of_scattering(bright, stacklevel=4)
        dark = options.get("background") is None and not np.any(model_background(volume))
        if dark and not things and aperture is None:
            extra = beside_cells(cube, total, bright, camera, options, 4)
    return Spectrum(
        cube.spectral,
        (total + stars) * ((centimetres / away) ** 2 / JANSKY),
        unit="Jy",
        distance=away,
        provenance={**(cube.provenance or {}), **extra},
    )


def _method(volume: Volume, camera: Orthographic) -> str | None:
    """Return how a pixel is divided: not at all, where cells are about as wide as each other.

    Refined cells may be far smaller than pixels. What keeps to the cells finds them all.
    """
    if is_structured(volume.grid):
        return None
    known = isinstance(volume.grid, TreeCells) and not isinstance(camera, Rings)
    return "radmc3d" if known else "adaptive"


def _converged(
    flux: Callable[[Any, str | None], np.ndarray],
    camera: Orthographic,
    method: str | None,
    tolerance: float,
    least: float,
) -> np.ndarray:
    """Return fluxes of pictures with ever more pixels, once they keep the tolerance.

    It is relative to each flux, or to this part of the largest.
    """
    total = flux(camera, method)
    while True:
        finer = _finer(camera, method)
        last, total = total, flux(finer, method)
        change, size = np.abs(total - last), np.abs(total)
        size = np.maximum(size, least * size.max())
        if np.all(change <= tolerance * size):
            return total
        if max(finer.resolution) >= _FINEST:
            break
        camera = finer
    worst = float(np.max(change / np.where(size > 0.0, size, 1.0)))
    warnings.warn(
        f"fluxes still change by {worst:.1g} from {max(camera.resolution)} to "
        f"{max(finer.resolution)} pixels; the tolerance is {tolerance:g}. Give a camera whose "
        "frame is around what is bright",
        stacklevel=4,
    )
    return total


def _finer(camera: Orthographic, method: str | None) -> Orthographic:
    """Return a camera with more pixels; halves of pixels may have the parts that these had."""
    if isinstance(camera, Rings):
        return camera.finer()
    factor = 1.5 if method == "radmc3d" else 2.0
    nx, ny = (math.ceil(factor * n) for n in camera.resolution)
    return camera.replace(resolution=(nx, ny))


def _areas(camera: Orthographic, cube: Cube) -> Any:
    """Return the area of pixels, as an array (ny, 1, 1) or a number."""
    if isinstance(camera, Rings):
        return camera.areas[:, :, None]
    return abs(float(np.prod(cube.pixel_size)))


def _distance(distance: Any) -> float:
    """Return a distance in cm; plain numbers are in cm, too."""
    away = plain(as_given(distance, "distance", "140 pc"), parse_unit("cm"), "distance")
    if np.ndim(away) or not 0.0 < away < np.inf:
        raise InputError(f"distance must be positive and finite, got {distance!r}")
    return float(away)


def _first_camera(volume: Volume, incl: Any, phi: Any, aperture: Any, away: float) -> Orthographic:
    grid = volume.grid
    if aperture is None and tuple(grid.coordinates) == CARTESIAN:
        return Orthographic(incl, phi, _TURNED, resolution=_FIRST)
    center = None if tuple(grid.coordinates) == CARTESIAN else (0.0, 0.0, 0.0)
    outer = float(np.linalg.norm(np.abs(grid.bounds).max(axis=1)))
    walls = np.linspace(0.0, outer, _FIRST // 2 + 1)
    if center is not None:
        # A ring for each wall of the grid, up to its largest distance from the origin.
        radial = np.asarray(grid.edges[0], np.float64)
        outer = radial[-1] if "theta" in grid.coordinates else outer
        inner = np.linspace(0.0, radial[0], _INNER_RINGS + 1)
        walls = np.unique(np.concatenate([inner, radial, [outer]]))
    if aperture is not None:
        radius = _aperture(aperture, away, grid)
        walls = np.append(walls[walls < radius], radius)
        if len(walls) <= _FIRST // 2:
            walls = np.linspace(0.0, radius, _FIRST // 2 + 1)
    return Rings(walls, None, _FIRST // 2, incl, phi, center=center)


def _is_angle(aperture: Any) -> bool:
    own = None if aperture is None else getattr(as_given(aperture, "aperture"), "unit", None)
    return own is not None and bool(own.is_equivalent("rad"))


def _aperture(aperture: Any, away: float, grid: Grid) -> float:
    given = as_given(aperture, "aperture", "2 arcsec")
    if is_listed(getattr(given, "value", given)) or isinstance(given, range):
        raise InputError(f"an aperture is the radius of one circle, got {aperture!r}")
    if _is_angle(given):
        centimetres = away * float(radians(given, "aperture"))
        radius = centimetres if grid.unit is None else centimetres / float(grid.unit.to("cm"))
    else:
        radius = float(on_grid(given, grid, "aperture", across=True))
    if not 0.0 < radius < np.inf:
        raise InputError(f"aperture must be a positive angle or length, got {aperture!r}")
    return radius


def _flux_of_points(
    volume: Volume,
    medium: Medium,
    rings: Rings,
    things: Sequence[SceneObject],
    options: dict[str, Any],
) -> np.ndarray:
    """Return the intensity times area of points of light within rings, as seen by the observer.

    Each is drawn into a picture of one pixel around it, from which that without it is taken.
    """
    total, (view, outer) = np.zeros(1), (rings.flat(), float(np.sqrt(rings.squares[-1])))
    for thing in things:
        if not isinstance(thing, Stars) or not (thing.points or thing.radii is None):
            raise InputError(
                "objects on rings and in apertures must be points: vm.Stars with luminosities, or "
                f"with radii and points=True; got {thing!r}; give a camera"
            )
        places = np.atleast_2d(np.asarray(plain(thing.positions, volume.unit, "positions")))
        discs = 0.0 if thing.radii is None else plain(thing.radii, volume.unit, "radii")
        side = max(1e-3 * outer, 4.0 * float(np.max(discs)))
        across, up, _ = view.project(places.T, volume.grid)
        for x, y in zip(across, up, strict=True):
            if np.hypot(x, y) > outer:
                continue
            near = view.replace(width=side, resolution=1, shift=(x, y))
            lit, dark = (
                observe(volume, medium, near, objects=some, **options).intensity[0, 0]
                for some in ([thing], [])
            )
            total = total + (lit - dark) * side**2
    return total
