"""Verdicts on two cameras: how often drawn calibrations of one lens are told apart, and what is found of others.

Lenses are drawn from their covariances; that covariances of calibrations are right is tested elsewhere.
"""

from collections import Counter
from dataclasses import replace
from math import inf

import numpy as np
import pytest
from scipy.stats import f as fisher

from camcal.cameras.catalogue import model_named
from camcal.cameras.directions import grid_pixels, lens_difference
from camcal.cameras.model import Camera, resized
from camcal.cameras.validity import ImageCircle
from camcal.errors import InvalidInput
from camcal.quality.camera_comparison import MOVED, OTHER, SAME, UNKNOWN, Calibrated, compare
from camcal.solve.losses import variance_ratio_beyond

SIZE = (1280, 960)
LENS = np.array([800.0, 802.0, 645.0, 474.0, -0.12, 0.06, 5e-4, -3e-4, 0.01])
STDS = np.array([0.5, 0.5, 0.6, 0.4, 2e-3, 6e-3, 2e-4, 1e-4, 5e-3])
MIXED = np.random.default_rng(0).normal(size=(9, 18))
ROOT = np.linalg.cholesky(MIXED @ MIXED.T) / np.linalg.norm(MIXED, axis=1)[:, None] * STDS[:, None]


def calibrated(rng=None, lens=LENS, views=inf, name="a.yaml"):
    """Return a drawn lens; of so many views its covariance is an estimate from as many lenses."""
    drawn = lens if rng is None else lens + ROOT @ rng.normal(size=9)
    scatter = ROOT if views == inf else ROOT @ rng.normal(size=(9, views - 1)) / np.sqrt(views - 1)
    camera = Camera(model_named("opencv5"), SIZE, drawn, scatter @ scatter.T)
    return Calibrated(name, camera, views=views)


def changed(**steps):
    names = model_named("opencv5").parameter_names
    return calibrated(lens=LENS + [steps.get(name, 0.0) for name in names], name="b.yaml")


@pytest.mark.parametrize("dof", [(3.3, 9.0), (6.0, 18.0), (1.5, 40.0), (8.0, 1e9)])
@pytest.mark.parametrize("chance", [0.05, 0.01, 0.001])
def test_the_chance_of_a_ratio_of_variances_is_that_of_fishers_distribution(dof, chance):
    # Paulson's approximation: 20 % of a chance of 0.001
    assert variance_ratio_beyond(fisher.isf(chance, *dof), *dof) == pytest.approx(chance, rel=0.25)
    assert variance_ratio_beyond(fisher.isf(chance, dof[0], 1e9), dof[0], inf) == pytest.approx(chance, rel=0.25)


@pytest.mark.parametrize(("distances", "views"), [((), inf), ((), 10), ((0.5, 2.0), 30)])
def test_calibrations_of_one_lens_are_the_same_and_differ_by_their_uncertainty(distances, views):
    rng = np.random.default_rng(1)
    found = [compare(calibrated(rng, views=views), calibrated(rng, views=views), distances) for _ in range(60)]
    assert Counter(each.verdict for each in found)[SAME] >= 58  # 0.06 of 60 are expected to be told apart
    ratios = [each.lengths[0][each.compared] / each.std[0][each.compared] / np.sqrt(2) for each in found]
    # the mean square of 60 differences that are of about two degrees of freedom each, known to 13 %
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1, abs=0.3)
    assert np.mean([each.total.chance < 0.1 for each in found]) < 0.25


def test_another_focal_length_or_principal_point_is_a_lens_that_moved():
    found = compare(calibrated(), changed(fx=8.0, fy=8.02, cx=3.0))
    assert found.verdict == MOVED
    assert found.focal == pytest.approx(0.01)
    assert found.shift == (3.0, 0.0)
    assert "focal length +1.00 %, principal point by (+3.0, +0.0) px" in found.words
    assert found.distortion.chance > 1e-3 > found.total.chance


def test_another_distortion_or_a_far_focal_length_is_another_camera():
    assert compare(calibrated(), changed(k1=0.03)).verdict == OTHER
    assert compare(calibrated(), changed(fx=80.0, fy=80.2)).verdict == OTHER


def test_one_lens_in_another_size_or_model_is_the_same():
    own = calibrated()
    half = replace(own, camera=resized(own.camera, (640, 480)))
    assert compare(own, half).verdict == compare(half, own).verdict == SAME
    plain = replace(own, camera=Camera(model_named("opencv8"), SIZE, [*LENS, 0, 0, 0]))
    found = compare(own, plain, [0.5, 2.0])
    assert found.words == "the same camera within what is known: the projections agree within 0.001 px (RMS)"
    assert found.difference.shape == (2, 713, 2)
    assert compare(own, own).figures(0)["worst_px"] == 0.0  # not what its last digits differ by


def test_points_of_one_distance_hide_a_focal_length_and_those_of_two_do_not():
    one, other = (Camera(model_named("pinhole"), SIZE, [focal, focal, 640, 480]) for focal in (800.0, 808.0))
    pixels = grid_pixels(np.linspace(0, 1279, 15), np.linspace(0, 959, 11))
    along = 1 / one.unproject(pixels).directions[:, 2]  # to a plane at 1 m
    plane = lens_difference(one, other, pixels, None, along)
    assert np.abs(plane).max() < 1e-6  # px
    twice, both = np.concatenate([pixels, pixels]), np.concatenate([along, 4 * along])
    moved = np.linalg.norm(lens_difference(one, other, twice, None, both), axis=1)
    assert 0.3 < moved.max() < np.linalg.norm(lens_difference(one, other, pixels), axis=1).max()


def test_what_cannot_be_judged_is_said():
    own, other = calibrated(), changed(fx=8.0, fy=8.0)
    bare = replace(other, camera=Camera(other.camera.model, SIZE, other.camera.parameters))
    assert compare(own, bare).words == "cannot be compared, because b.yaml states no covariance"
    images = frozenset("ab")
    found = compare(replace(own, images=images), replace(other, images=frozenset("bc")))
    assert (found.verdict, found.common_images, found.std) == (UNKNOWN, 1, None)
    assert "the same 1 image: their errors are correlated" in found.words
    left, right = (np.array([[x, 0], [x + 500, 0], [x + 500, 959], [x, 959]]) for x in (0, 700))
    found = compare(replace(own, region=left), replace(other, region=right))
    assert "different parts of the image" in found.words
    with pytest.raises(InvalidInput, match=r"a.yaml and b.yaml cannot be compared, because images of 1280 x 960"):
        compare(own, replace(other, camera=replace(other.camera, image_size=(1280, 720))))


def test_only_where_both_cameras_are_known_is_compared():
    own = replace(calibrated(), region=np.array([[0.0, 0.0], [639, 0], [639, 959], [0, 959]]))
    half = resized(changed(fx=8.0, fy=8.0).camera, (640, 480))
    found = compare(own, Calibrated("b.yaml", half, circle=ImageCircle((640, 480), (320.0, 240.0), 200.0)))
    pixels = grid_pixels(found.u, found.v)[found.compared]
    assert pixels[:, 0].max() < 645
    assert np.hypot(*(pixels - (640, 480)).T).max() < 420
    assert found.compared.any()


def test_pixels_that_do_not_move_with_what_is_uncertain_do_no_harm():
    def camera(focal):
        known = np.diag([0.25, 0, 0, 0])
        return Calibrated("a.yaml", Camera(model_named("pinhole"), (801, 601), [focal, 800.0, 400.0, 300.0], known))

    assert compare(camera(800.0), camera(800.5)).verdict == SAME
    assert compare(camera(800.0), camera(820.0)).verdict == OTHER  # fx without fy is no zoom
