"""`observe`: what a telescope sees of a volume, as a cube of intensities at frequencies."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..drawing import render
from ..errors import InputError, MemoryNeededError
from ..expressions import Expression, IntervalOps
from ..image import Image
from ..image.cube import Cube
from ..image.spectral_axis import SpectralAxis
from ..large.partition import drawn_in_blocks
from ..media.contract import Medium
from ..media.sum import with_each
from ..physics.constants import Constants, constants_named
from ..progress import reporter, with_progress
from ..rendering.cache import Cache, VolumeStatistics
from ..rendering.empty_picture import keeping, warn_caller
from ..rendering.options import check_options
from ..rendering.partition import Partition
from ..schemes.channels import fits_single, in_units_of
from ..spectral.lines import Lines
from ..spectral.medium import Bands, SpectralMedium, hottest, some_channels
from ..units import unit_of
from ..volume import Volume
from .cells import beside_cells, warn_of_scattering
from .light import (
    INTENSITY,
    check_channels,
    check_distance,
    intensities,
    lit,
    model_background,
    scene_objects,
    with_room_for,
)

if TYPE_CHECKING:
    from ..progress import Progress

# More channels are drawn in groups: in one, 1000 of them would take seven times the cube's memory.
_TOGETHER = 64
# Groups of so few are not made smaller.
_FEWEST = 8
# Values between cells, as a part of the largest in a cell.
_BEYOND = 1.5


@with_progress
def observe(
    volume: Volume,
    medium: Medium,
    camera: Any = None,
    *,
    wavelengths: Any = None,
    frequencies: Any = None,
    velocities: Any = None,
    distance: Any = None,
    objects: Any = None,
    background: Any = None,
    constants: str | Constants = "codata",
    memory: Any = None,
    progress: Progress = None,
    _quiet: bool = False,
    **options: Any,
) -> Cube:
    """Solve the transfer equation at frequencies: an image at each of them.

    Parameters
    ----------
    volume : Volume
        Grid and fields.
    medium : Medium
        Of `Dust`, `Lines`, `FreeFree` and other spectral media, added with ``+``.
    camera : Camera, optional
        As in `render`.
    wavelengths, frequencies, velocities : array_like or Quantity, or SpectralAxis
        One of them: wavelengths (plain numbers are micron), frequencies (Hz), or velocities, which
        `channels` makes; its ``line`` is looked up in the molecules of the medium.
    distance : Quantity, optional
        Of the observer, for solid angles and fluxes; of pictures with lengths.
    objects : sequence of SceneObject, optional
        Colours may be spectra, such as `Blackbody`. Default: the stars of a model of RADMC-3D, as
        points.
    background : float, array_like, Quantity or spectrum, optional
        Intensity behind everything, such as ``vm.Blackbody(2.725)``; plain numbers are in
        erg/s/cm²/Hz/sr. Default: the external field of a model of RADMC-3D, else none.
    constants : {"codata", "radmc3d"}
        Physical constants; RADMC-3D's also take its rules of interpolation in tables.
    memory : str or int, optional
        As in `render`, for volumes larger than memory. As many channels as it allows are drawn in
        one pass through the chunks.
    progress : bool or callable, optional
        As in `render`.
    **options
        Those of `render`: ``clip``, ``scheme``, ``tolerance``, ``precision``, ``samples``,
        ``antialias``, ``device``, ``cutoff``, ``executor`` …

    Returns
    -------
    Cube
        Intensities in erg/s/cm²/Hz/sr, one channel for each frequency, in the order given. Of more
        than 64 channels there is no transparency, and `optical_depth` is drawn when it is asked
        for, so that memory is needed for little more than the cube.

    Raises
    ------
    InputError
        If there are no frequencies, or several kinds of them; or as in `render`.
    UnitsError
        If units do not fit.

    Warns
    -----
    UserWarning
        If dust scatters light at the frequencies; if an optically thin picture of all of a volume
        in memory has 1 % more or less light than its cells, which is then in the provenance.

    Examples
    --------
    >>> import voluminous as vm
    >>> core = vm.models.prestellar_core(16)
    >>> dust = vm.Dust("density * 2e-26 g", 15.0, vm.Opacity.power_law(3.5, 870.0, 1.8))
    >>> vm.observe(core, dust, wavelengths=[870.0, 1300.0]).shape
    (400, 400, 2)
    """
    check_arguments("observe", volume, medium, options)
    axis = spectral_axis(medium, wavelengths, frequencies, velocities)
    check_distance(distance, volume)
    if memory is not None:
        options["memory"] = memory
    partition = Partition(volume)
    if any(options.get(name) is not None for name in ("memory", "executor", "checkpoint")):
        partition = drawn_in_blocks(volume, medium, memory)
        volume = partition.volume
    known = constants_named(constants)
    things = scene_objects(objects, volume)
    behind = model_background(volume) if background is None else background
    moving = any(
        isinstance(part, Lines) and part.velocity is not None for part in medium.components()
    )
    if volume.grid.mirror and moving and options.get("scheme") != "first-order":
        volume = volume.unfolded()  # velocities change their sign where fields are interpolated
        partition = Partition(volume)
    bands = bands_of(partition, medium, axis.frequencies, known)
    dark = not things and isinstance(behind, float) and behind == 0.0
    for name, value in {"wavelengths": wavelengths, "frequencies": frequencies}.items():
        if value is not None:
            check_channels(name, value, medium, bands, dark)
    bands = with_room_for([*things, behind], replace(bands, once=len(axis) > _TOGETHER))
    tuned, count = at_frequencies(medium, bands), len(axis)
    _warn_of_lines(tuned, bands)
    if not _quiet:
        warn_of_scattering(tuned, stacklevel=4)
    together = count if memory is not None or count <= _TOGETHER else _group(count)
    report, light = reporter(), intensities(behind, bands)

    def draw(part: slice) -> Image:
        """Draw some of the channels, in their units."""
        own = bands.some(part.start, part.stop)

        def reported(done: int, total: int) -> None:
            report(part.start * total + (part.stop - part.start) * done, count * total)

        with keeping(empty):
            return render(
                volume,
                tuned if part == slice(0, count) else some_channels(tuned, part),
                camera,
                objects=tuple(lit(thing, own) for thing in things),
                background=light[..., part] if light.ndim and light.shape[-1] == count else light,
                progress=reported,
                **options,
            )

    while True:
        firsts = range(0, count, together)
        groups = [slice(first, min(first + together, count)) for first in firsts]
        empty: list[str] = []
        try:
            cube = _cube(draw, groups, bands, axis, medium, distance)
            if len(empty) == len(groups):
                warn_caller(empty[0])
            break
        except MemoryNeededError:  # which is found before anything is drawn
            if memory is None or together <= _FEWEST:
                raise
            together = (together + 1) // 2
    if _quiet or things or np.any(light):
        return cube
    total = cube.intensity.sum(axis=(0, 1), dtype=np.float64) * cube.pixel_area
    cells_flux = beside_cells(cube, total, tuned, camera, {**options, "memory": memory}, 4)
    return (
        cube.replace(provenance={**(cube.provenance or {}), **cells_flux}) if cells_flux else cube
    )


def check_arguments(verb: str, volume: Any, medium: Any, options: Iterable[str]) -> None:
    """Refuse what is no volume or medium, and options that `render` does not have."""
    if not isinstance(volume, Volume):
        raise InputError(f"{verb} needs a vm.Volume first, got {type(volume).__name__}")
    if not isinstance(medium, Medium):
        raise InputError(
            f"{verb} needs a medium (vm.Dust, vm.Lines, vm.FreeFree, …) second, got "
            f"{type(medium).__name__}"
        )
    check_options(options)


def _warn_of_lines(medium: Medium, bands: Bands) -> None:
    parts = [part for part in medium.components() if isinstance(part, Lines)]
    if any(part.is_seen for part in parts) or len(parts) < len(medium.components()):
        return
    molecule, nu = parts[0].molecule, bands.frequencies
    k = int(np.abs(np.log(molecule.frequencies[:, None] / nu)).min(axis=1).argmin())
    ends = f"{molecule.labels[molecule.up[k]]}-{molecule.labels[molecule.low[k]]}"
    warnings.warn(
        f"no channel is near a line of {molecule.name}; the nearest is {ends}, at "
        f"{molecule.frequencies[k] / 1e9:.9g} GHz: velocities=vm.channels(-5, 5, 40, "
        f"line='{molecule.name} {ends}')",
        stacklevel=4,
    )


def _group(count: int) -> int:
    return 15 * max(2, round(count / 600))


def _cube(
    draw: Callable[[slice], Image],
    groups: list[slice],
    bands: Bands,
    axis: SpectralAxis,
    medium: Medium,
    distance: Any,
) -> Cube:
    """Return channels that are drawn group by group as a cube of intensities.

    Of several groups nothing but intensities are kept: optical depths are drawn when asked for.
    """
    planes: dict[str, Any] = {}
    shares, brightest, whole = [], 0.0, len(groups) == 1
    for part in groups:
        image, unit = draw(part), bands.unit[part]
        peaks = np.max(np.abs(image.intensity), axis=(0, 1), initial=0.0)
        brightest = max(brightest, float(np.max(peaks * unit)))
        if image.error is not None:
            shares.append(image.error / (np.max(peaks) or 1.0))
        for name in ("intensity", "lower", "upper"):
            own = getattr(image, name)
            if own is None:
                continue
            scaled = in_units_of(unit, own)
            if whole:
                planes[name] = scaled
                continue
            if part.start == 0:
                shape = (*scaled.shape[:2], len(axis))
                fits = all(map(fits_single, bands.unit))
                planes[name] = np.empty(shape, scaled.dtype if fits else np.float64)
            planes[name][..., part] = scaled
    if shares:
        # The error is that of the brightest channel, and the same part of the maximum in others.
        planes["error"] = in_units_of(brightest, np.max(shares, axis=0))

    def depth() -> np.ndarray:
        if whole:
            return np.asarray(image.plane("optical_depth"))
        return np.concatenate([draw(part).plane("optical_depth") for part in groups], axis=-1)

    return Cube(
        **planes,
        spectral=axis,
        transparency=image.plane("transparency") if whole else None,
        optical_depth=depth if not whole or image.waits_for_depth else depth(),
        x=image.x,
        y=image.y,
        unit=image.unit,
        pixel_size=image.pixel_size,
        wcs=image.wcs,
        camera=image.camera,
        distance=distance,
        intensity_unit=INTENSITY,
        provenance={
            **(image.provenance or {}),
            "medium": medium.describe(),
            "constants": bands.constants.name,
        },
    )


def spectral_axis(
    medium: Medium, wavelengths: Any, frequencies: Any, velocities: Any
) -> SpectralAxis:
    """Return the channels of an observation, with the frequency at rest of their line."""
    given = {"wavelengths": wavelengths, "frequencies": frequencies, "velocities": velocities}
    some = {name: value for name, value in given.items() if value is not None}
    if len(some) != 1:
        raise InputError(
            "give one of wavelengths=, frequencies= and velocities=, such as "
            f"wavelengths=[0.87, 1.3] * u.mm; got {', '.join(some) or 'none'}"
        )
    ((name, value),) = some.items()
    axis: SpectralAxis = value
    if not isinstance(value, SpectralAxis):
        unit = unit_of(value) or {"wavelengths": "micron", "frequencies": "Hz"}.get(name, "km / s")
        axis = SpectralAxis(value, unit)
    if axis.rest is not None or (axis.kind != "velocity" and axis.line is None):
        return axis
    molecules = [part.molecule for part in medium.components() if isinstance(part, Lines)]
    if not molecules:
        raise InputError(
            "velocities need a line: vm.channels(-5, 5, 40, rest=230.538 * u.GHz), or a medium "
            "with vm.Lines and vm.channels(…, line='CO 2-1')"
        )
    if axis.line is None:
        raise InputError("velocities need a line: vm.channels(-5, 5, 40, line='CO 2-1')")
    failed = None
    for molecule in molecules:
        try:
            rest = float(molecule.frequencies[molecule.line(axis.line)])
            return axis.at_rest(rest)
        except InputError as error:
            failed = failed or error
    assert failed is not None
    raise failed


def _extremes(
    partition: Partition, statistics: VolumeStatistics, expr: Expression, in_cells: bool = False
) -> tuple[float, float]:
    fields = {name: statistics.range_of(name) for name in expr.names}
    with np.errstate(all="ignore"):
        found = IntervalOps().number(expr.evaluate(IntervalOps(), fields))
    low, high = float(found.lo), float(found.hi)
    if in_cells or not (np.isfinite(low + high) and not np.any(found.nan)):
        # Of p/ρ beside a vacuum there is no bound; fields between cells may be beyond these.
        values = partition.extremes_of(expr)
        values = values[np.isfinite(values)]
        low, high = values.min(initial=np.inf), _BEYOND * values.max(initial=-np.inf)
    return float(low), float(high)


def bands_of(
    partition: Partition, medium: Medium, frequencies: np.ndarray, constants: Constants
) -> Bands:
    """Return what a medium needs to know to have a channel for each frequency.

    Raises
    ------
    InputError
        If a part of the medium is not spectral.
    """
    volume = partition.volume
    extremes = functools.partial(_extremes, partition, Cache(volume).statistics)
    wrong = [part for part in medium.components() if not isinstance(part, SpectralMedium)]
    if wrong:
        raise InputError(
            f"observe needs media that emit at any frequency (vm.Dust, vm.Lines, vm.FreeFree, "
            f"vm.SpectralMedium.from_function), got {wrong[0]!r}; render draws colours"
        )
    nu = np.asarray(frequencies, dtype=np.float64)
    bands = Bands(nu, np.ones(len(nu)), 1.0, constants, volume, extremes)
    warmest = hottest(medium, bands)
    if warmest is None:
        return bands
    # 2hν³/c² / (exp(x) - 1), of any size, as a power of two.
    x = constants.planck_exponent * nu / warmest
    size = np.log2(constants.planck_factor * nu**3)
    size -= np.log2(np.expm1(np.minimum(x, 600.0))) + np.maximum(x - 600.0, 0.0) / np.log(2.0)
    unit = 2.0 ** np.clip(np.round(size), -1000.0, 1000.0)
    return replace(bands, hottest=warmest, unit=unit)


def tuned(
    volume: Volume,
    medium: Medium,
    *,
    wavelengths: Any = None,
    frequencies: Any = None,
    velocities: Any = None,
    constants: str | Constants = "codata",
) -> Medium:
    """Return a spectral medium with channels; the arguments are those of `observe`."""
    axis = spectral_axis(medium, wavelengths, frequencies, velocities)
    known = constants_named(constants)
    return at_frequencies(medium, bands_of(Partition(volume), medium, axis.frequencies, known))


def at_frequencies(medium: Medium, bands: Bands) -> Medium:
    """Return a medium with a channel for each frequency."""

    def tuned(part: Medium) -> Medium:
        assert isinstance(part, SpectralMedium)
        return part.at_frequencies(bands)

    with np.errstate(all="ignore"):
        return with_each(medium, tuned)
