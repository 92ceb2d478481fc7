"""Writes fixtures.json: what Python makes of cameras, tones and codecs, for the tests of the page."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
from fake_server import float16, log_jpeg, pack

import voluminous as vm
from voluminous.geometry import angles_towards, image_axes

OPTIONS = [
    {},
    {"exposure": 0.3},
    {"stretch": "sqrt", "exposure": 2.0},
    {"stretch": "gamma", "vmin": 0.05},
    {"stretch": "asinh", "exposure": 5.0},
    {"stretch": "asinh", "softening": 0.02},
    {"stretch": "log", "gamut": "clip"},
    {"stretch": 3.3, "exposure": 4.0, "gamut": "clip"},
    {"vmax": 0.7, "vmin": 0.1},
    {"channels": 1},
    {"channels": [2, 0]},
    {"channels": [2, 1, 0], "exposure": 3},
    {"mix": [[1, 0.5, 0], [0, 0.5, 0.2], [0.3, 0.1, 1]], "exposure": 1.5},
    {"exposure": "rgb"},
    {"colormap": "viridis", "channels": 0},
    {"colormap": "inferno", "channels": 2, "exposure": 2.0, "stretch": "sqrt"},
    {"colormap": "viridis", "channels": 1, "norm": "log"},
    {"colormap": "viridis", "channels": 1, "norm": "log", "vmin": 1e-3, "vmax": 0.5},
    {"channels": 0, "norm": "log"},
]


def limits(values: np.ndarray) -> list[list[float]]:
    return [
        [float(c.min()), float(c[c > 0].min(initial=1e30)), float(c.max())]
        for c in np.moveaxis(values, -1, 0)
    ]


def tones() -> dict:
    import matplotlib

    random = np.random.default_rng(1)
    cases = []
    for channels, given in [
        (3, OPTIONS),
        (1, [{}, {"stretch": "asinh"}]),
        (2, [{}]),
        (5, [{"exposure": 0.5}]),
    ]:
        values = (10.0 ** random.uniform(-4, 0.5, (3, 5, channels))).astype(np.float32)
        values[0, 0] = 0.0
        image = vm.Image(values)
        for options in given:
            shown = {
                "channels": channels,
                "exposure": automatic(image, options),
                "limits": limits(values),
            }
            cases.append(
                {
                    "options": options,
                    "shown": shown,
                    "values": values.reshape(-1, channels).tolist(),
                    "rgb": image.to_rgb(**options).reshape(-1, 3).tolist(),
                }
            )
    signed = random.normal(size=(3, 5, 1)).astype(np.float32)
    image = vm.Image(signed)
    shown = {"channels": 1, "exposure": image.exposure, "limits": limits(signed)}
    cases.append(
        {
            "options": {},
            "shown": shown,
            "values": signed.reshape(-1, 1).tolist(),
            "rgb": image.to_rgb().reshape(-1, 3).tolist(),
        }
    )
    tables = {
        n: (matplotlib.colormaps[n](np.linspace(0, 1, 256))[:, :3] * 255)
        .round()
        .astype(int)
        .ravel()
        .tolist()
        for n in ("gray", "viridis", "inferno", "RdBu_r")
    }
    return {"cases": cases, "tables": tables}


def automatic(image: vm.Image, options: dict) -> float:
    """The exposure that a server tells: that of the channels as they are mixed."""
    from voluminous.image.tone import automatic_exposure, mixed_channels

    return automatic_exposure(
        mixed_channels(image.intensity, options.get("channels"), options.get("mix"))[1]
    )


def main() -> None:
    random = np.random.default_rng(2)
    angles = [
        [0, 0, 0],
        [90, 0, 0],
        [90, 90, 0],
        [60, 30, 0],
        [180, 20, 10],
        [45, -120, 77],
        [127.3, 211.1, -33.3],
    ]
    towards = random.normal(size=(6, 3))
    values = (10.0 ** random.uniform(-3, 1, (5, 7, 2))).astype(np.float32)
    low = 3.0 - 14
    codes = np.arange(256)
    told = {
        "axes": [{"angles": a, "axes": image_axes(*a).tolist()} for a in angles],
        "towards": [{"direction": d.tolist(), "angles": list(angles_towards(d))} for d in towards],
        "half": {
            "width": 7, "height": 5, "channels": 2, "low": low, "bytes": base64.b64encode(float16(values, low)).decode(),
            "values": np.moveaxis((values[::-1] * 2.0**-low).astype(np.float16).astype(float) * 2.0**low, -1, 0).ravel().tolist(),
        },
        "log": {"low": -9.5, "high": 2.25, "values": [0.0, *(2.0 ** (-9.5 + 11.75 * (codes[1:] - 1) / 254)).tolist()]},
        "message": base64.b64encode(pack({"kind": "frame", "number": 7, "text": "τ ≤ 1"}, bytes(range(5)))).decode(),
        "tones": tones(),
    }  # fmt: skip
    tones_, told["tones"] = told["tones"], None
    rounded = {
        **told,
        "tones": json.loads(
            json.dumps(tones_), parse_float=lambda text: float(f"{float(text):.6g}")
        ),
    }
    Path(__file__).with_name("fixtures.json").write_text(json.dumps(rounded) + "\n")
    assert len(log_jpeg(values, low, 3.0)) > 100


if __name__ == "__main__":
    main()
