"""Numbers in text files: as Fortran writes them, to the last bit."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import voluminous as vm
from voluminous.io.fortran import TextFile, fortran_numbers

FINITE = st.floats(allow_nan=False, allow_infinity=False)


def read(path, text, count):
    path.write_bytes(text)
    with TextFile(path) as file:
        return file.data(1, count).plane(0)


@settings(max_examples=60, deadline=None)
@given(values=st.lists(FINITE, min_size=1, max_size=50), style=st.sampled_from(["e", "E", "D", ""]))
@example(values=[5e-324, -0.0, 1.7976931348623157e308], style="")
def test_every_double_comes_back(tmp_path_factory, values, style):
    def written(x):
        text = f"{x:.16e}"
        if style == "" and len(text.partition("e")[2]) == 4:
            return text.replace("e", "")  # as Fortran has it: 1.0-100
        return text.replace("e", style or "e")

    path = tmp_path_factory.mktemp("text") / "numbers"
    found = read(path, "\n".join(map(written, values)).encode() + b"\n", len(values))
    assert struct.pack(f"{len(values)}d", *values) == found.tobytes()


@pytest.mark.parametrize(
    ("token", "value"),
    [
        ("1", 1.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("+1.5D+03", 1500.0),
        ("1.0-100", 1e-100),
        ("1.0+100", 1e100),
        ("-Infinity", -np.inf),
        ("1q2", 100.0),
    ],
)
def test_fortran(token, value):
    assert fortran_numbers(token.encode(), 1).tolist() == [value]


@pytest.mark.parametrize("token", ["x", "1e", "1.2.3", "0x10", "1_000", "1,5", "--1"])
def test_other_texts_are_no_numbers(token):
    with pytest.raises(vm.FileFormatError, match="line 3: expected a number"):
        fortran_numbers(b"1 2\n3\n4 " + token.encode(), 1)


@pytest.mark.parametrize("size", [200, 500_000], ids=["one block", "three"])
def test_blocks(tmp_path, size):
    values = np.random.default_rng(1).normal(size=size)
    lines = "".join(f"{x!r}{' ' if k % 3 else chr(10)}" for k, x in enumerate(values.tolist()))
    np.testing.assert_array_equal(read(tmp_path / "a", lines.encode(), size), values)
    for wrong in (size + 1, size - 1):
        message = f"expected {wrong} numbers, found {size}"
        with pytest.raises(vm.FileFormatError, match=message):
            read(tmp_path / "a", lines.encode(), wrong)
    wrong = lines.replace("\n", "\nxy ", 20).encode()
    with pytest.raises(vm.FileFormatError, match="line 2: expected a number, got 'xy'"):
        read(tmp_path / "a", wrong, size + 20)


@pytest.mark.parametrize(
    ("text", "what", "message"),
    [
        (b"1\n2.5\n", lambda f: f.integers(2, "n"), "line 2: n: expected a whole number"),
        (b"1\n", lambda f: f.integers(2, "n"), "line 1: n: expected 2 whole numbers"),
        (b"1 2\n3 4\n", lambda f: f.reals(3, "w"), "line 2: w: expected 3 numbers, found 4"),
        (b"1 x\n", lambda f: f.reals(3, "w"), "line 1: expected a number, got 'x'"),
        (b"0\n1\n2\n", lambda f: f.flags("t"), "line 3: t: expected 0 or 1"),
        (b"0\n11\n", lambda f: f.flags("t"), "line 2: t: expected 0 or 1"),
        (b"\n1\n", lambda f: f.end(), "line 2: the end: expected nothing more"),
    ],
)
def test_errors_name_the_line(tmp_path, text, what, message):
    (tmp_path / "a").write_bytes(text)
    with TextFile(tmp_path / "a") as file, pytest.raises(vm.FileFormatError, match=message):
        what(file)
