"""Reference models as voluminous scenes."""

import numpy as np

import voluminous as vm
from reference import Case, Model


def volume_of(model: Model, *, emit_without_extinction: bool = True) -> vm.Volume:
    """Return the model's grid with what its mode needs."""
    grid = vm.CartesianGrid(*model.edges, unit="cm")
    if model.mode == "gaussian_log10_density":
        return vm.Volume(grid, n=model.fields["n"])
    j, alpha = model.j, model.alpha
    if not emit_without_extinction:
        # RADMC-3D divides by the extinction: where that is 0 it emits nothing.
        j = np.where(alpha > 0, j, 0)
    columns = {f"j{c}": j[..., c] for c in range(model.nchan)}
    columns |= {f"a{c}": alpha[..., c] for c in range(model.nchan)}
    return vm.Volume(grid, columns)


def medium_of(model: Model) -> vm.Medium:
    """Return the model's medium."""
    if model.mode == "gaussian_log10_density":
        return sum(
            vm.Gaussian("log10(n)", k["lg0"], k["sigma"], k["h"], k["a"], model.w)
            for k in model.components
        )
    channels = range(model.nchan)
    return vm.Coefficients([f"j{c}" for c in channels], [f"a{c}" for c in channels])


def camera_of(case: Case) -> vm.Orthographic | vm.Perspective:
    """Return the case's camera."""
    c = case.camera
    size = [2.0 * half for half in c["half_size"]]
    if c["type"] == "local":
        return vm.Perspective(
            c["observer"],
            c["point"],
            width=size,
            posang=c["posang"],
            resolution=(c["nx"], c["ny"]),
            projection={1: "flat", 2: "spherical"}[c["projection"]],
            zenith=c["zenith"],
        )
    shift = c.get("zoomcenter", (0.0, 0.0))
    return vm.Orthographic(
        c["incl"],
        c["phi"],
        c["posang"],
        width=size,
        resolution=(c["nx"], c["ny"]),
        center=c["point"],
        shift=shift,
    )
