"""Numbers of NumPy's in kernels: nothing is read beyond the end of their memory."""

import subprocess
import sys

import numpy as np
import pytest

from voluminous.backend import aligned, dr, from_host, get_backend

# Numbers that end where a page does, behind which nothing may be read.
PROGRAM = """
import ctypes, mmap, sys
import numpy as np
import voluminous as vm
from voluminous.backend import from_host, get_backend

def at_the_end(values):
    page = mmap.PAGESIZE
    size = -(-values.nbytes // page) * page
    block = mmap.mmap(-1, size + page)
    address = ctypes.addressof(ctypes.c_char.from_buffer(block))
    assert ctypes.CDLL(None).mprotect(ctypes.c_void_p(address + size), page, 0) == 0
    found = np.frombuffer(block, values.dtype, len(values), size - values.nbytes)
    found[:] = values
    return found

shape = (3, 5, 7)
for dtype in (np.float32, np.float64, np.int16):
    numbers = at_the_end(np.arange(105).astype(dtype))
    assert np.asarray(from_host(get_backend("cpu", "double").Float, numbers) + 1)[-1] == 105
    volume = vm.Volume(vm.CartesianGrid.uniform(shape, (-1, 1)), f=numbers.reshape(shape))
    assert np.shares_memory(volume.array("f"), numbers)
    camera = vm.Orthographic(40, 30, resolution=9)
    for scheme in ("first-order", "second-order", "olson-kunasz", "post-classified"):
        assert vm.render(volume, vm.Coefficients("f", 0.1), camera, scheme=scheme).intensity.any()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="protects a page of memory")
def test_nothing_is_read_beyond_the_end_of_memory():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr or f"ended by signal {-done.returncode}"


@pytest.mark.parametrize("count", [1, 15, 16, 17, 320])
@pytest.mark.parametrize("offset", [0, 1, 8])
def test_numbers_are_what_they_were(count, offset):
    values = np.arange(400.0)[offset : offset + count]
    held = aligned(values)
    np.testing.assert_array_equal(held, values)
    assert held.__array_interface__["data"][0] % 128 == 0
    Float = get_backend("cpu", "double").Float
    np.testing.assert_array_equal(np.asarray(2 * from_host(Float, values)), 2 * values)
    assert dr.width(from_host(Float, values)) == count
