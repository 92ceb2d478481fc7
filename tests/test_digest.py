"""Hashes of arrays: in place or in parts, any change of a byte shows."""

import numpy as np
import pytest

from voluminous import digest as digests
from voluminous.digest import digest


@pytest.mark.parametrize("shape", [(), (0,), (7,), (3, 4, 5), (64, 64, 64)])
@pytest.mark.parametrize("dtype", ["f4", "f8", ">f4", "u1", "i2", "?"])
def test_equal_contents_have_equal_digests_and_any_change_shows(shape, dtype, monkeypatch):
    monkeypatch.setattr(digests, "_PART", 1 << 10)
    values = np.random.default_rng(0).integers(0, 2, shape).astype(dtype)
    before = digest(values)
    assert digest(values.copy()) == before
    flat = np.ascontiguousarray(values).reshape(-1)
    for place in {0, flat.size // 2, flat.size - 1} if flat.size else ():
        changed = flat.copy()
        changed[place] = 1 - changed[place]
        assert digest(changed.reshape(shape)) != before


def test_parts_that_change_places_show(monkeypatch):
    monkeypatch.setattr(digests, "_PART", 1 << 10)
    values = np.repeat(np.arange(4, dtype="f4"), 256)
    assert digest(values) != digest(values[::-1].copy())
