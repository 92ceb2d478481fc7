"""Reference images computed with RADMC-3D, and the inputs that made them.

The data is not part of the repository. It is looked for in the directory named by the environment
variable ``VOLUMINOUS_TEST_DATA`` (default: ``shared`` beside the repository); tests that need it
are skipped where it is absent. Only NumPy is used here: no renderer is imported.
"""

from __future__ import annotations

import functools
import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

CARTESIAN = (
    "core",
    "random32",
    "box_40x24x30",
    "nonuniform",
    "direct20",
    "background_1ch",
    "mass_mom_energy",
)
CARTESIAN_COORDINATES = 1
REGULAR_GRID = 0


def data_directory() -> Path:
    """Return the directory that should hold ``radmc3d/*.npz`` (it may not exist)."""
    beside_the_repository = Path(__file__).resolve().parents[2] / "shared"
    return Path(os.environ.get("VOLUMINOUS_TEST_DATA", beside_the_repository))


def require_data() -> Path:
    """Return the data directory, or skip the calling test if it holds no reference images."""
    if reason := why_absent():
        pytest.skip(reason)
    return data_directory()


def why_absent() -> str:
    """Say why there are no reference images; the empty string if there are."""
    directory = data_directory() / "radmc3d"
    if all((directory / f"{name}.npz").is_file() for name in CARTESIAN):
        return ""
    return f"no RADMC-3D reference images in {directory}; set VOLUMINOUS_TEST_DATA"


@dataclass(frozen=True)
class Case:
    """One reference image and how it was made.

    Attributes
    ----------
    id : str
        Name, unique within its model.
    order : int
        1: j and alpha constant in each cell. 2: averaged to vertices, RADMC-3D's second order.
    quantity : str
        ``"intensity"``, ``"tau"`` (optical depth) or ``"tausurf"``.
    tausurf : float or None
        Optical depth of the surface, for ``quantity == "tausurf"``.
    background : numpy.ndarray
        Intensity behind everything, shape (C,).
    camera : dict
        The camera, in cm and degrees (local observers: radians for ``half_size``).
    interpolates_source : bool
        Second order with S = j/alpha, not j, averaged to the vertices and interpolated.
    image : numpy.ndarray
        Shape (ny, nx, C), float64, row 0 at the bottom.
    """

    id: str
    order: int
    quantity: str
    tausurf: float | None
    background: np.ndarray
    camera: dict
    interpolates_source: bool
    image: np.ndarray = field(repr=False)


@dataclass(frozen=True)
class Model:
    """The input of one RADMC-3D run and the images made from it.

    Attributes
    ----------
    name : str
        Name of the file.
    edges : tuple of numpy.ndarray
        The cell walls along x, y and z, in cm, float64.
    fields : dict of str to numpy.ndarray
        Cell values, float64, each of shape (nx, ny, nz) and indexed [ix, iy, iz].
    nchan : int
        Number of channels, C.
    mode : str
        How j and alpha follow from the fields: ``"gaussian_log10_density"`` or ``"direct"``.
    components : list of dict
        Centre ``lg0``, width ``sigma``, emission ``h`` (C,) and absorption ``a`` (C,).
    w : float
        Length by which amplitudes are divided, in cm.
    cases : dict of str to Case
        The images, by their id.
    """

    name: str
    edges: tuple[np.ndarray, np.ndarray, np.ndarray]
    fields: dict[str, np.ndarray] = field(repr=False)
    nchan: int
    mode: str
    components: list[dict]
    w: float
    cases: dict[str, Case] = field(repr=False)

    @functools.cached_property
    def coefficients(self) -> tuple[np.ndarray, np.ndarray]:
        """The cells' emissivity j and extinction alpha, each (nx, ny, nz, C), per cm."""
        rules = {"gaussian_log10_density": self._gaussian, "direct": self._direct}
        return rules[self.mode]()

    @property
    def j(self) -> np.ndarray:
        """Emissivity of the cells, shape (nx, ny, nz, C), per cm."""
        return self.coefficients[0]

    @property
    def alpha(self) -> np.ndarray:
        """Extinction coefficient of the cells, shape (nx, ny, nz, C), per cm."""
        return self.coefficients[1]

    def _gaussian(self) -> tuple[np.ndarray, np.ndarray]:
        log_n = np.log10(self.fields["n"])[..., None]
        j = np.zeros((*log_n.shape[:3], self.nchan))
        alpha = np.zeros_like(j)
        for k in self.components:
            g = np.exp(-0.5 * ((log_n - k["lg0"]) / k["sigma"]) ** 2)
            j += np.array(k["h"]) / self.w * g
            alpha += np.array(k["a"]) / self.w * g
        return j, alpha

    def _direct(self) -> tuple[np.ndarray, np.ndarray]:
        if "rho" in self.fields:  # mass, momentum and energy per volume as extinctions
            rho, v = self.fields["rho"], self.fields["v"]
            alpha = np.stack([rho, rho * np.abs(v), 0.5 * rho * v * v], axis=-1)
            return np.zeros_like(alpha), alpha
        names = range(self.nchan)
        j = np.stack([self.fields[f"j{c}"] for c in names], axis=-1)
        return j, np.stack([self.fields[f"alpha{c}"] for c in names], axis=-1)


@functools.lru_cache(maxsize=len(CARTESIAN))
def load_model(name: str) -> Model:
    """Load one Cartesian model; skip the calling test if the data is absent."""
    stored, meta = stored_in(require_data() / "radmc3d" / f"{name}.npz")
    if (meta["coordsystem"], meta["grid_style"]) != (CARTESIAN_COORDINATES, REGULAR_GRID):
        raise ValueError(f"{name} is not a regular Cartesian model; expected one of {CARTESIAN}")
    return model_of(stored, meta, _fields(stored, meta))


def stored_in(path: Path) -> tuple[dict, dict]:
    """Return the arrays in a file, and what it tells of them."""
    with np.load(path) as file:
        stored = {key: file[key] for key in file.files}
    return stored, json.loads(str(stored["meta"]))


def model_of(stored: dict, meta: dict, fields: dict[str, np.ndarray]) -> Model:
    """Return the model that arrays and what is told of them stand for, on any grid."""
    return Model(
        name=meta["name"],
        edges=tuple(stored[f"edges_x{axis}"].astype(np.float64) for axis in (1, 2, 3)),
        fields=fields,
        nchan=meta["nchan"],
        mode=meta["mode"],
        components=meta["components"],
        w=meta["w"],
        cases={c["id"]: _case(c, meta["nchan"], stored) for c in meta["cases"]},
    )


def cartesian_cases() -> list:
    """Return one ``pytest.param(model name, case id)`` for every image of the Cartesian models.

    Without the data: one parameter that is skipped and says why.
    """
    if reason := why_absent():
        return [pytest.param("", "", marks=pytest.mark.skip(reason=reason), id="no data")]
    return [
        pytest.param(name, case, id=f"{name}-{case}")
        for name in CARTESIAN
        for case in load_model(name).cases
    ]


def _fields(stored: dict, meta: dict) -> dict[str, np.ndarray]:
    shape = tuple(len(stored[f"edges_x{axis}"]) - 1 for axis in (1, 2, 3))
    if "n_octant" in stored:
        return {"n": _mirrored(stored["n_octant"].astype(np.float64))}
    if "fields" in stored:  # columns of flat arrays with the first index fastest
        columns = stored["fields"].astype(np.float64).T
        flat = zip(meta["field_names"], columns, strict=True)
        return {name: column.reshape(shape, order="F") for name, column in flat}
    return {key: stored[key].astype(np.float64) for key in ("n", "rho", "v") if key in stored}


def _mirrored(octant: np.ndarray) -> np.ndarray:
    for axis in range(3):
        octant = np.concatenate([np.flip(octant, axis), octant], axis)
    return octant


def _case(meta: dict, nchan: int, stored: dict) -> Case:
    background = meta["background"]
    return Case(
        id=meta["id"],
        order=meta["order"],
        quantity=meta["quantity"],
        tausurf=meta["tausurf"],
        background=np.zeros(nchan) if background is None else np.array(background),
        camera=meta["camera"],
        interpolates_source="camera_interpol_jnu" in meta.get("radmc3d_inp", ""),
        image=stored["img_" + meta["id"]],
    )
