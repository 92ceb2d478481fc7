"""Numbers in texts: every one is the nearest double, wherever in the file it is."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from voluminous.io.radmc3d import blocks
from voluminous.io.radmc3d.decimals import PADDING, decimals
from voluminous.io.radmc3d.fortran import number
from voluminous.io.radmc3d.powers import LEAST, MOST, scaled
from voluminous.io.radmc3d.text import TextFile

FORMATS = ("%.16e", "%.17e", "%.18e", "%.20e", "%.3e", "%.0f", "%g", "%.17g", "%r", "%25.16E")


def read(path, text, offset=0):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    found = blocks.NumbersInText(path, offset)
    return found.read(0, found.count)


def same(found, expected):
    np.testing.assert_array_equal(np.asarray(found).view(np.int64), bits(expected))


def bits(values):
    return np.asarray(values, np.float64).view(np.int64)


DOUBLES = st.floats(allow_nan=False, allow_infinity=False)
DIGITS = st.text("0123456789", min_size=1, max_size=22)


@st.composite
def decimal_texts(draw):
    """Return decimal numbers as programs and people write them."""
    if draw(st.booleans()):
        return draw(st.sampled_from(FORMATS)) % draw(DOUBLES)
    text = draw(st.sampled_from(["", "-", "+"])) + draw(DIGITS)
    if draw(st.booleans()):
        text += "." + draw(st.one_of(st.just(""), DIGITS))
    if draw(st.booleans()):
        text += draw(st.sampled_from("eEdD")) + draw(st.sampled_from(["", "-", "+"]))
        text += str(draw(st.integers(0, 270)))
    return text


@settings(deadline=None, max_examples=300)
@given(texts=st.lists(decimal_texts(), min_size=1, max_size=30), size=st.integers(40, 400))
def test_any_number_in_any_block(tmp_path_factory, texts, size):
    expected = [float(t.replace("d", "e").replace("D", "e")) for t in texts]
    if any(map(math.isinf, expected)):
        return
    path = tmp_path_factory.mktemp("text") / "a.inp"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blocks, "_BLOCK", size)
        same(read(path, "\n".join(texts)), expected)
        same(read(path, " \t\r\n " + "  ".join(texts) + "\n\n"), expected)


def exact(whole, exponent):
    """Return the nearest double of an exact fraction: Python rounds it correctly."""
    return float(Fraction(whole) * Fraction(10) ** exponent)


@settings(deadline=None, max_examples=300)
@given(
    pairs=st.lists(
        st.tuples(st.integers(0, 10**19 - 1), st.integers(LEAST, MOST)), min_size=1, max_size=20
    )
)
def test_products_are_nearest_or_unsure(pairs):
    # With types: of whole numbers on both sides of 2^63 NumPy makes doubles, which lose digits.
    whole = np.array([w for w, _ in pairs], np.uint64)
    exponent = np.array([e for _, e in pairs], np.int64)
    unsure = np.zeros(len(pairs), bool)
    found = scaled(whole, exponent, unsure)
    expected = np.array([exact(w, e) for w, e in pairs])
    same(found[~unsure], expected[~unsure])


def test_numbers_half_way_between_doubles_are_not_guessed():
    """Of 2^53 + 1 and its like the nearest double depends on the last bit."""
    whole = np.array([2**53 + 1, 2**53 + 2, 2**53 + 3, 1], np.uint64)
    unsure = np.zeros(4, bool)
    found = scaled(whole, np.array([0, 0, 0, 23]), unsure)  # 5^23 has 54 bits
    np.testing.assert_array_equal(unsure, [True, False, True, True])
    assert found[1] == 2**53 + 2


def test_usual_numbers_are_read_all_at_once():
    """What programs write needs no second look: that is where the speed comes from."""
    rng = np.random.default_rng(1)
    # From 2^53 to 10^23 short numbers are half way between doubles now and then.
    values = rng.choice([1, -1], 20_000) * 10 ** rng.uniform(-120, 14, 20_000)
    for form in ("%.16e", "%.9e", "%.18e", "%24.16E", "%.15g"):
        text = (" " + "\n".join(form % v for v in values)).encode() + b" " * PADDING
        found, unsure, starts, ends = decimals(np.frombuffer(text, np.uint8))
        assert unsure.sum() <= 1
        expected = np.array([float(token) for token in text.split()])
        same(found[~unsure], expected[~unsure])
        assert text[starts[7] : ends[7]] == text.split()[7]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1.0D+05", 1e5),
        ("1.0d-5", 1e-5),
        ("1.0-100", 1e-100),
        ("-0.12345678901234+101", -0.12345678901234e101),
        ("+.5", 0.5),
        ("5.", 5.0),
        ("-0", -0.0),
        ("-0.000E+00", -0.0),
        ("4.9406564584124654e-324", 5e-324),
        ("2.2250738585072011e-308", 2.2250738585072011e-308),
        ("1.7976931348623157E+308", 1.7976931348623157e308),
        ("1e-400", 0.0),
        ("0.000000000000000000000000000001", 1e-30),
        ("123456789012345678901234567890", 123456789012345678901234567890.0),
        ("9007199254740993", 9007199254740992.0),
        ("9007199254740993.00000000000000000001", 9007199254740994.0),
        ("00000000000000000000012", 12.0),
        ("Infinity", np.inf),
        ("-inf", -np.inf),
    ],
)
def test_unusual_numbers(tmp_path, text, value):
    same([number(text.encode())], [value])
    same(read(tmp_path / "a.inp", f"1.5\n{text}\n2.5"), [1.5, value, 2.5])


def test_not_a_number_is_one(tmp_path):
    assert np.isnan(read(tmp_path / "a.inp", "NaN\n+nan\nnan ")).all()


@pytest.mark.parametrize(
    "text",
    ["1.0x", "1,0", "1.0.0", "e5", "1e", "1e+", "--1", "0x10", "1_0", "****", "3*1.0", ".", "+",
     "nano", "1e400", "1.0e5e5", "1e99999999999", "\u0661"],
)  # fmt: skip
def test_what_is_no_number_is_named_with_its_line(tmp_path, text):
    with pytest.raises(vm.FileFormatError, match=r"^line 4: "):
        read(tmp_path / "a.inp", f"1.5\n\n2.5\n{text}\n2.5\n")
    with pytest.raises(vm.FileFormatError, match=r"^line 3: "):
        read(tmp_path / "a.inp", f"8\n1.5\n{text}\n2.5\n", offset=2)


def test_lines_are_counted_across_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr(blocks, "_BLOCK", 64)
    lines = ["1.25"] * 100 + ["oops"] + ["1.25"] * 50
    with pytest.raises(vm.FileFormatError, match="line 101: expected a number, got 'oops'"):
        read(tmp_path / "a.inp", "\n".join(lines))


def test_text_without_end_is_no_number(tmp_path, monkeypatch):
    monkeypatch.setattr(blocks, "_BLOCK", 64)
    with pytest.raises(vm.FileFormatError, match="line 1"):
        read(tmp_path / "a.inp", "1" * 10_000)


def test_a_part_of_the_numbers(tmp_path, monkeypatch):
    monkeypatch.setattr(blocks, "_BLOCK", 128)
    values = np.random.default_rng(0).random(500)
    read(tmp_path / "a.inp", "\n".join(map(repr, values.tolist())))
    found = blocks.NumbersInText(tmp_path / "a.inp")
    assert found.count == 500
    for first, count in ((0, 1), (0, 500), (17, 250), (499, 1), (100, 0)):
        same(found.read(first, count), values[first : first + count])


def test_an_empty_text(tmp_path):
    assert len(read(tmp_path / "a.inp", "")) == 0
    assert len(read(tmp_path / "a.inp", "\n \n")) == 0


def test_a_text_cut_within_its_last_number(tmp_path):
    """The last one would be wrong, and nothing else would tell."""
    path = tmp_path / "a.inp"
    lines = [f"{v:.9e}" for v in np.random.default_rng(0).random(20)]
    path.write_text("\n".join(lines))
    TextFile(path).__exit__(None, None, None)  # without an end of line, but whole
    path.write_text("\n".join(lines)[:-2])
    with pytest.raises(vm.FileFormatError, match="cut short: it ends within a number"):
        TextFile(path)
    path.write_text("\n".join(str(v) for v in np.arange(20.0) / 4))  # of different lengths
    TextFile(path).__exit__(None, None, None)
