"""Products of transforms as text: what is read, and what is refused in which words."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.geometry.frame_graph import evaluate
from camcal.geometry.pose import NamedTransform, Pose

VECTORS = np.random.default_rng(6).normal(size=(3, 2, 3))
KNOWN = {
    f"{a}_T_{b}": NamedTransform(a, b, Pose.from_vector(*vectors))
    for (a, b), vectors in zip((("a", "b"), ("c", "b"), ("c", "d")), VECTORS, strict=True)
}
A_B, C_B, C_D = (KNOWN[name].pose for name in ("a_T_b", "c_T_b", "c_T_d"))


@pytest.mark.parametrize(
    ("text", "name", "expected"),
    [
        ("a_T_b", "a_T_b", A_B),
        ("inv(a_T_b)", "b_T_a", A_B.inverse()),
        ("a_T_b * inv(c_T_b)", "a_T_c", A_B @ C_B.inverse()),
        ("a_T_b@inv(c_T_b) @ c_T_d", "a_T_d", A_B @ C_B.inverse() @ C_D),
        ("inv(c_T_d) * (c_T_b * inv(a_T_b))", "d_T_a", C_D.inverse() @ C_B @ A_B.inverse()),
        (" inv(inv(a_T_b)) ", "a_T_b", A_B),
    ],
)
def test_a_product_is_worked_out_and_named(text, name, expected):
    found = evaluate(text, KNOWN)
    assert found.name == name
    np.testing.assert_allclose(found.derived.pose.matrix(), expected.matrix(), atol=1e-14)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a_T_b * c_T_b", r"'b' does not meet 'c'; did you mean a_T_b \* inv\(c_T_b\)\?"),
        ("c_T_b * c_T_d", r"did you mean inv\(c_T_b\) \* c_T_d\?"),
        ("a_T_b * c_T_d", "they are a_T_b and c_T_d"),
        ("b_T_a", r"write inv\(a_T_b\)"),
        ("a_T_bb", "Did you mean 'a_T_b'?"),
        ("zebra", "there are a_T_b, c_T_b, c_T_d"),
        ("a_T_b + a_T_b", "is not supported"),
        ("a_T_b * 2", "is not supported"),
        ("inv(a_T_b, a_T_b)", "is not supported"),
        ("__import__('os').system('true')", "is not supported"),
        ("a_T_b.pose", "is not supported"),
        ("a_T_b *", "is not an expression"),
        ("", "is not an expression"),
        ("a_T_b\0", "is not an expression"),
        ("a_T_b" + " * a_T_b" * 400, "characters"),
    ],
)
def test_anything_else_is_refused_and_says_why(text, message):
    with pytest.raises(InvalidInput, match=message):
        evaluate(text, KNOWN)


@given(st.text(alphabet="abcd_T()*@inv +-.'\n1", max_size=40))
def test_no_text_is_a_bug(text):
    try:
        found = evaluate(text, KNOWN)
    except InvalidInput:
        return
    assert found.name.count("_T_") == 1
