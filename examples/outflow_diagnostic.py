"""How much moves, and how fast: mass, momentum and energy of an outflow from twenty sides.

python examples/outflow_diagnostic.py [DiskOutflow_t0.20.athdf] [pixels]

The diagnostic of Peters, The physics of volume rendering (2014), section 6: an isosurface of the
density of fast gas, coloured by its temperature; and totals of that gas as optical depths, by rays
and exactly, beside sums over cells. Without a snapshot (of Athena++) an outflow is made.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from astropy.table import Table
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import voluminous as vm

QUANTITIES = {
    "mass": "density",
    "momentum": "density * abs(los('velocity'))",
    "energy": "0.5 * density * norm('velocity')**2",
}
FAST = "norm('velocity') > 8"
FIELDS = ["density", "pressure", "velocity_x", "velocity_y", "velocity_z"]


def snapshot(path: Path) -> vm.Volume:
    """Return gas in units of 1000 au, km/s and 1e-18 g / cm3, and its temperature in K."""
    volume = vm.open(path, FIELDS)
    for name in FIELDS:  # single precision in the file; what is computed of it is not
        volume[name] = volume.array(name).astype(float)
    return _with_temperature(volume)


def stand_in(levels: int = 2) -> vm.Volume:
    """Return two lobes of fast, hot gas in an envelope, on an octree."""

    def near(x, y, z, size):
        return np.hypot(np.hypot(x, y), 0.5 * z) < 8 * size

    walls = np.linspace(-6, 6, 17)
    volume = vm.Volume(vm.OctreeGrid.from_function(walls, walls, walls, near, levels))
    volume["R"] = "sqrt(x**2 + y**2)"
    volume["lobe"] = "exp(-(R / (0.35 + 0.22 * abs(z)))**4) * exp(-(z / 4)**6)"
    volume["knots"] = "1 + 0.5 * sin(4 * z + 2 * x) * cos(3 * y)"
    envelope = "100 * exp(-(z / 0.3)**2 - R**2 / 2)"
    volume["density"] = f"0.005 + lobe * knots * 0.12 / (1 + 0.1 * z**2) + (1 - lobe) * {envelope}"
    volume["pressure"] = "density * (0.0355 + 30 * lobe / (1 + 0.3 * z**2))"
    for axis, speed in (("x", "2 * x"), ("y", "2 * y"), ("z", "14 * z / (1 + 0.2 * abs(z))")):
        volume[f"velocity_{axis}"] = f"lobe * {speed}"
    return _with_temperature(volume)


def _with_temperature(volume: vm.Volume) -> vm.Volume:
    volume["temperature"] = "10 * pressure / density / 0.0355"  # 10 K is (0.19 km/s)^2
    return volume


def picture(volume: vm.Volume, pixels: int = 400) -> vm.Image:
    """Return two isosurfaces of the density of gas faster than 4 km/s, above the disc."""
    warmth = vm.ColorBy("temperature", "inferno", vmin=300, vmax=1.2e4, norm="log")
    surfaces = [
        vm.Isosurface("density", level, warmth, opacity, where="norm('velocity') > 4", shading=0.7)
        for level, opacity in ((0.03, 0.35), (0.08, 0.6))
    ]
    disc = vm.Gaussian("log10(density)", 1.5, 0.1, (0.03, 0.06, 0.15), 0.05, path_length="auto")
    camera = vm.Orthographic(75, 60, width=8, resolution=pixels)
    return vm.render(volume, sum(surfaces, disc), camera, tolerance=1e-2)


def cameras(count: int = 20, pixels: int = 200) -> list[vm.Orthographic]:
    """Return views that are spread evenly over half of all directions, the first along the jet."""
    turns = np.arange(count - 1) + 0.5
    incl = np.degrees(np.arccos(1 - turns / (count - 1)))
    phi = np.degrees(np.pi * (1 + 5**0.5) * turns) % 360
    angles = [(20.0, 0.0), *zip(incl.tolist(), phi.tolist(), strict=True)]
    return [vm.Orthographic(*pair, resolution=pixels) for pair in angles]


def sums(volume: vm.Volume, camera: vm.Orthographic) -> list[float]:
    """Return the totals as sums over cells, with nothing but NumPy."""
    rho, *velocity = (volume.array(n).astype(float) for n in (FIELDS[0], *FIELDS[2:]))
    incl, phi = np.radians(camera.incl), np.radians(camera.phi)
    sight = (np.sin(phi) * np.sin(incl), np.cos(phi) * np.sin(incl), -np.cos(incl))
    along = sum(v * n for v, n in zip(velocity, sight, strict=True))
    square = sum(v**2 for v in velocity)
    mass = np.where(square > 64, rho * volume.grid.cell_volumes, 0.0)
    return [float(np.sum(mass * q)) for q in (1.0, np.abs(along), 0.5 * square)]


def by_rays(volume: vm.Volume, camera: vm.Orthographic, samples: int = 1) -> list[float]:
    """Return the totals as sums over pixels of optical depths along rays."""
    images = [
        vm.column(volume, f"({q}) * ({FAST})", camera, precision="double", samples=samples)
        for q in QUANTITIES.values()
    ]
    return [float(image.intensity.sum()) * image.pixel_area for image in images]


def exactly(volume: vm.Volume, camera: vm.Orthographic) -> list[float]:
    """Return the totals as sums over pixels of exact columns."""
    found = vm.measure(volume, QUANTITIES, FAST, camera, maps=True)
    return [float(image.intensity.sum()) * image.pixel_area for image in found.maps.values()]


def diagnosed(volume: vm.Volume, views: list[vm.Orthographic]) -> Table:
    """Return a row for each view: the sums, and how far the other two are from them."""
    table = Table({"incl": [v.incl for v in views], "phi": [v.phi for v in views]})
    direct = np.array([sums(volume, view) for view in views])
    methods = {"rays": by_rays, "exact": exactly}
    errors = {
        name: np.array([method(volume, view) for view in views]) / direct - 1
        for name, method in methods.items()
    }
    for k, name in enumerate(QUANTITIES):
        table[name] = direct[:, k]
        for method, off in errors.items():
            table[f"{name}, {method}"] = off[:, k]
    for name in table.colnames:
        small = name.endswith(tuple(methods))
        table[name].info.format = ".0e" if small else ".1f" if name in ("incl", "phi") else ".7g"
    return table


def plot(table: Table, axes: Axes) -> None:
    """Draw how far totals from pixels are from those of the cells."""
    colors = dict(zip(QUANTITIES, ("#7b5cd6", "#d9822b", "#2f9e77"), strict=True))
    for method, marker in (("rays", "o"), ("exact", "s")):
        for name, color in colors.items():
            off = np.maximum(np.abs(table[f"{name}, {method}"]), 1e-17)
            axes.semilogy(table["incl"], off, marker, color=color, ms=5, label=f"{name}, {method}")
    axes.set(xlabel="inclination [deg]", ylabel="|total / sum over cells - 1|", ylim=(1e-17, 1))
    axes.legend(ncols=2, fontsize=8, loc="center")


def main() -> None:
    """Print the table, save it, the plot and the picture."""
    numbers = [int(word) for word in sys.argv[1:] if word.isdecimal()]
    paths = [Path(word) for word in sys.argv[1:] if not word.isdecimal()]
    volume = snapshot(paths[0]) if paths else stand_in()
    picture(volume, *numbers).save("outflow_diagnostic.png", exposure=1)
    table = diagnosed(volume, cameras())
    print(*table.pformat(max_lines=-1, max_width=-1), sep="\n")
    table.write("outflow_diagnostic.ecsv", overwrite=True)
    figure = Figure(figsize=(6, 4), layout="constrained")
    plot(table, figure.subplots())
    figure.savefig("outflow_totals.png", dpi=120)
    print("outflow_diagnostic.png, outflow_diagnostic.ecsv, outflow_totals.png")


if __name__ == "__main__":
    main()
