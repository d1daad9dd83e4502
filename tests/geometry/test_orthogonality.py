"""How far nine numbers are from a rotation."""

import numpy as np
import pytest

from camcal.geometry import rotation as so3
from camcal.geometry.rotation import examine

ROTATION = so3.exp(np.array([0.3, -0.5, 1.0]))


def test_a_rotation_is_one():
    found = examine(ROTATION)
    assert found.is_rotation(1e-12)
    assert found.fault(1e-12) == ""
    assert found.determinant == pytest.approx(1.0)


def test_a_shear_is_told_in_numbers_and_how_far_the_nearest_rotation_is():
    # [[1, s], [0, 1]] has R Rᵀ - I = [[s², s], [s, 0]]; the nearest rotation turns by s/2 and stretches by as much
    sheared = np.eye(3)
    sheared[0, 1] = 0.01
    found = examine(sheared)
    assert found.error == pytest.approx(0.01)
    assert found.angle == pytest.approx(0.005, rel=1e-3)  # by the first order in s
    assert "0.29°" in found.fault(1e-6)
    assert found.can_be_fixed


def test_a_reflection_is_called_one_and_is_never_to_be_mended():
    found = examine(ROTATION @ np.diag([1.0, 1, -1]))
    assert found.is_reflection
    assert not found.can_be_fixed
    assert "det = -1, a reflection" in found.fault(1e-6)


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), 2 * np.eye(3), np.full((3, 3), 1e200), np.full((3, 3), np.nan)])
def test_what_is_far_from_any_rotation_has_no_nearest_one(matrix):
    found = examine(matrix)
    assert not found.can_be_fixed
    assert "orthonormality error" in found.fault(1e-6)
