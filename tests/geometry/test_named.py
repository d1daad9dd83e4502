"""Transforms with names, and covariances of what is made of them: against sampling and by hand."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Derived, NamedTransform, Pose, frames_of, retract

FIRST = Pose.from_vector(np.array([0.3, -0.2, 0.9]), np.array([1.0, -2.0, 0.5]))
SECOND = Pose.from_vector(np.array([-0.6, 0.4, 0.1]), np.array([0.2, 0.7, 2.0]))


def covariance(seed, size):
    root = np.random.default_rng(seed).normal(size=(6, 6)) * size
    return root @ root.T


def test_the_covariance_of_a_product_is_that_of_samples():
    rng, count = np.random.default_rng(3), 4000
    own = {"a_T_b": covariance(1, 1e-3), "b_T_c": covariance(2, 1e-3)}
    derived = (Derived.of("a_T_b", FIRST) @ Derived.of("b_T_c", SECOND)).inverse()
    steps = {name: rng.multivariate_normal(np.zeros(6), matrix, count) for name, matrix in own.items()}
    (r1, t1), (r2, t2) = (
        retract(pose.rotation, pose.translation, steps[name]) for pose, name in ((FIRST, "a_T_b"), (SECOND, "b_T_c"))
    )
    inverse = np.swapaxes(r1 @ r2, 1, 2)
    translations = -(inverse @ (np.einsum("nij,nj->ni", r1, t2) + t1)[..., None])[..., 0]
    turns = so3.log(inverse @ derived.pose.rotation.T)
    scatter = np.cov(np.concatenate([translations - derived.pose.translation, turns], axis=1).T)
    found = derived.covariance(own)
    root = np.linalg.inv(np.linalg.cholesky(found))
    # eigenvalues of a scatter of 4000 samples of 6 numbers are within 4 √(6/4000) of 1, here 16 %
    assert np.abs(np.linalg.eigvalsh(root @ scatter @ root.T) - 1).max() < 0.16


def test_transforms_that_are_not_independent_have_the_covariance_of_samples():
    rng, count = np.random.default_rng(5), 4000
    root = np.random.default_rng(6).normal(size=(12, 4)) * 1e-3  # four causes in common
    steps = rng.standard_normal((count, 4)) @ root.T
    both, own = root @ root.T, covariance(7, 1e-4)
    steps[:, :6] += rng.multivariate_normal(np.zeros(6), own, count)
    both[:6, :6] += own
    factors = {
        0: NamedTransform("b", "a", FIRST, both[:6, :6], "rig.yaml:1", {"rig.yaml:2": both[:6, 6:]}),
        1: NamedTransform("c", "a", SECOND, both[6:, 6:], "rig.yaml:2", {"rig.yaml:1": both[6:, :6]}),
    }
    derived = Derived.of(0, FIRST) @ Derived.of(1, SECOND).inverse()
    rotations, translations = zip(
        *(
            retract(pose.rotation, pose.translation, own)
            for pose, own in ((FIRST, steps[:, :6]), (SECOND, steps[:, 6:]))
        ),
        strict=True,
    )
    turned = rotations[0] @ rotations[1].transpose(0, 2, 1)
    moved = translations[0] - np.einsum("nij,nj->ni", turned, translations[1])
    turns = so3.log(turned @ derived.pose.rotation.T)
    scatter = np.cov(np.concatenate([moved - derived.pose.translation, turns], axis=1).T)
    found = derived.covariance_of(factors)
    root = np.linalg.inv(np.linalg.cholesky(found))
    assert np.abs(np.linalg.eigvalsh(root @ scatter @ root.T) - 1).max() < 0.16  # as above
    independent = derived.covariance({key: item.covariance for key, item in factors.items()})
    assert np.abs(np.linalg.eigvalsh(root @ independent @ root.T) - 1).max() > 1


def test_what_cancels_has_no_uncertainty_left():
    first = Derived.of("a_T_b", FIRST)
    for product in (first @ first.inverse(), first.inverse() @ first):
        np.testing.assert_allclose(product.covariance({"a_T_b": covariance(1, 0.1)}), 0, atol=1e-15)


def test_a_turn_of_one_milliradian_a_kilometre_off_moves_a_metre():
    far = Derived.of("b_T_c", Pose(np.eye(3), np.array([1000.0, 0, 0])))
    near = Derived.of("a_T_b", Pose.identity())
    found = (near @ far).covariance({"a_T_b": np.diag([0, 0, 0, 0, 0, 1e-6]), "b_T_c": None})
    np.testing.assert_allclose(np.sqrt(np.diag(found)), [0, 1, 0, 0, 0, 1e-3])


def test_without_covariances_there_is_none():
    assert Derived.of("a_T_b", FIRST).covariance({"a_T_b": None}) is None


def test_the_inverse_of_a_named_transform_has_the_other_name_and_comes_back():
    transform = NamedTransform("a", "b", FIRST, covariance(1, 1e-2))
    inverse = transform.inverse()
    assert inverse.name == "b_T_a"
    back = inverse.inverse()
    np.testing.assert_allclose(back.pose.matrix(), FIRST.matrix(), atol=1e-15)
    np.testing.assert_allclose(back.covariance, transform.covariance, rtol=1e-9)


@pytest.mark.parametrize("name", ["a", "a_T_", "_T_b", "a_T_b_T_c", "aTb", ""])
def test_what_is_no_name_of_a_transform_is_refused(name):
    with pytest.raises(InvalidInput, match="a_T_b"):
        frames_of(name)
