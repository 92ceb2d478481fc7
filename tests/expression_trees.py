"""Random expressions, for tests of everything that evaluates them."""

from __future__ import annotations

from hypothesis import strategies as st

ARITHMETIC = ["+", "-", "*", "/", "//", "%", "**"]
LOGIC = ["<", "<=", ">", ">=", "==", "!=", "and", "or"]
UNARY = ["log10", "log", "exp", "sqrt", "abs", "sin", "cos", "tan", "tanh", "not ", "-"]
FORMS = [f"({{}} {operator} {{}})" for operator in ARITHMETIC + LOGIC]
FORMS += [f"({name}({{}}))" for name in UNARY]
FORMS += ["({})**2", "({})**-3", "({})**0.5", "atan2({}, {})", "min({}, {})", "max({}, {}, {})"]
FORMS += ["where({}, {}, {})", "clip({}, {}, {})", "({} if {} else {})", "({} < {} <= {})"]
FORMS += ["interp({}, [-2, 0.5, 1, 3], [1, -1, 4, 4])"]
LITERALS = st.one_of(st.integers(0, 4).map(str), st.floats(0.125, 8, width=16).map(str))


@st.composite
def expressions(draw, depth=4):
    """Strategy: the text of an expression of x, y and z."""
    if depth == 0 or draw(st.integers(0, 5)) == 0:
        return draw(st.one_of(st.sampled_from("xyz"), LITERALS))
    form = draw(st.sampled_from(FORMS))
    return form.format(*(draw(expressions(depth - 1)) for _ in range(form.count("{}"))))
