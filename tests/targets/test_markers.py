"""Markers against rendered truth. What it does not prove: prints whose ink runs, and lenses with anisotropic blur."""

import cv2
import numpy as np
import pytest
from tagged import facing, photograph, pinhole, true_corners

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.simulate.render import Exposure
from camcal.targets.marker_fit import looks_alike
from camcal.targets.markers import FAMILIES, detect_markers
from camcal.targets.pattern import APRILTAGS, family_named

TILTED = [
    (3, facing(-0.10, -0.06, 0.45, (0.5, 0.2, 0.3))),
    (7, facing(0.07, -0.07, 0.6, (-0.4, 0.5, -0.2))),
    (11, facing(-0.12, 0.10, 0.9, (0.1, -0.6, 1.0))),
    (19, facing(0.10, 0.06, 0.38, (0.2, 0.4, -2.0))),
    (23, facing(0.5, -0.3, 1.3, (0.3, 0.3, 0.5))),
]


@pytest.fixture(scope="module")
def camera():
    return pinhole()


@pytest.fixture(scope="module")
def scene(camera):
    gray = photograph(camera, TILTED)
    return gray, detect_markers(gray, "tag36h11"), np.array([true_corners(camera, pose) for _, pose in TILTED])


def test_corners_of_rendered_tags_are_right_to_hundredths_of_a_pixel(scene):
    _, markers, truth = scene
    assert markers.ids.tolist() == [marker for marker, _ in TILTED]
    errors = markers.corners - truth
    assert np.sqrt(np.mean(errors**2)) < 0.025  # 0.01 measured on tags of 80 px, 0.02 on those of 20 px
    assert np.abs(errors).max() < 0.08  # four standard deviations of the smallest tag


def test_the_covariance_is_that_of_the_errors(scene):
    _, markers, truth = scene
    errors = markers.corners - truth
    nees = np.einsum("mki,mkij,mkj->mk", errors, np.linalg.inv(markers.covariance), errors) / 2
    assert 0.4 < nees.mean() < 1.7  # 20 corners, correlated within a tag: ± 0.3 is one standard deviation


@pytest.mark.parametrize("method", ["NONE", "SUBPIX", "CONTOUR", "APRILTAG"])
def test_corners_are_better_than_by_any_refinement_of_opencv(scene, method):
    gray, markers, truth = scene
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = getattr(cv2.aruco, f"CORNER_REFINE_{method}")
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(gray)
    places = np.roll(np.reshape(corners, (-1, 4, 2)), 2, axis=1)
    theirs = dict(zip(np.ravel(ids).tolist(), places, strict=True))
    for row, marker in enumerate(markers.ids):
        if marker in theirs:
            ours = np.sqrt(np.mean((markers.corners[row] - truth[row]) ** 2))
            assert ours < 0.5 * np.sqrt(np.mean((theirs[marker] - truth[row]) ** 2))


@pytest.mark.parametrize(("side", "limit"), [(40, 0.06), (100, 0.06), (200, 0.1)])
def test_edges_that_a_lens_bends_leave_the_corners_where_they_are(side, limit):
    # half of the barrel of an action camera; the limits are three to five times what is measured, 0.1 is SUBPIX's best
    bent = Camera(model_named("opencv5"), (640, 480), np.array([400.0, 400, 330, 232, -0.2, 0.04, 0.001, -0.001, 0]))
    distance = 0.05 * 400 / side
    pose = facing(-0.35 * distance, 0.2 * distance, distance, (0.2, 0.3, 0.4))
    markers = detect_markers(photograph(bent, [(5, pose)]), "tag36h11")
    assert markers.ids.tolist() == [5]
    assert np.abs(markers.corners[0] - true_corners(bent, pose)).max() < limit


@pytest.mark.parametrize("family", [name for name in FAMILIES if not name.endswith(("_100", "_250", "_1000"))])
def test_markers_of_every_family_begin_at_the_top_left_as_printed(family):
    camera, pose = pinhole((160, 120), 400.0), facing(0.01, 0.0, 0.5, (0.0, 0.2, 0.1))
    markers = detect_markers(photograph(camera, [(8, pose)], family=family), family)
    assert markers.ids.tolist() == [8]
    assert np.abs(markers.corners[0] - true_corners(camera, pose)).max() < 0.05  # turned, it would be off by the side


def test_apriltags_are_upright_as_the_apriltag_project_prints_them():
    # Code 0 of tag36h11 in AprilTag 2, whose bits go row by row from the top-left
    bits = np.array([int(bit) for bit in f"{0xD5D628584:036b}"]).reshape(6, 6)
    family = family_named("tag36h11")
    assert np.array_equal(family.printed(range(1))[0, 1:-1, 1:-1], bits)
    assert np.array_equal(family.printed(range(1), border=2)[0], np.pad(bits, 2))
    assert np.array_equal(family.drawing(0).ink[1:-1, 1:-1], bits[::-1, ::-1])
    assert np.array_equal(family_named("DICT_APRILTAG_36h11").printed(range(1))[0, 1:-1, 1:-1], bits[::-1, ::-1])


@pytest.mark.parametrize("name", ["36h11", "tag36h11", "TAG36H11"])
def test_families_go_by_their_usual_names(name):
    assert family_named(name).name == "tag36h11"


def test_an_unknown_family_names_the_nearest():
    with pytest.raises(InvalidInput, match="did you mean tag36h11"):
        family_named("tag36h12")
    with pytest.raises(InvalidInput, match="did you mean DICT_4X4_50"):
        detect_markers(np.zeros((64, 64), np.uint8), "DICT_4x4_51")


def test_every_apriltag_family_has_its_size():
    assert [family_named(name).count for name in APRILTAGS] == [30, 35, 2320, 587]


def test_an_id_seen_twice_is_left_out_and_said():
    camera = pinhole((320, 240), 300.0)
    tags = [(4, facing(-0.1, 0, 0.6)), (4, facing(0.1, 0, 0.6)), (5, facing(0, 0.12, 0.6))]
    markers = detect_markers(photograph(camera, tags), "tag36h11")
    assert markers.ids.tolist() == [5]
    (warning,) = markers.warnings
    assert warning.text == "id 4 detected 2 times, none used; --repeated-ids keep uses all"


def test_repeated_ids_may_be_kept_and_come_from_top_to_bottom():
    camera = pinhole((320, 240), 300.0)
    low, high, other = facing(-0.1, 0.05, 0.6), facing(0.1, -0.05, 0.6), facing(0, 0.14, 0.6)
    gray = photograph(camera, [(4, low), (4, high), (5, other)])
    markers = detect_markers(gray, "tag36h11", keep_repeated=True)
    assert markers.ids.tolist() == [4, 4, 5]
    assert markers.warnings == ()
    for corners, pose in zip(markers.corners, (high, low, other), strict=True):
        assert np.abs(corners - true_corners(camera, pose)).max() < 0.05


def test_what_only_looks_a_little_like_a_marker_costs_no_real_one():
    camera = pinhole((320, 240), 300.0)
    gray = photograph(camera, [(4, facing(-0.1, 0, 0.6)), (5, facing(0.1, 0, 0.6))])
    drawing = family_named("tag36h11").drawing(4)
    (own, other) = detect_markers(gray, "tag36h11").corners
    turned = np.roll(own, 2, axis=0)  # as the AprilTag project prints them
    assert looks_alike(gray, turned, drawing) > 0.9
    assert looks_alike(gray, np.roll(other, 2, axis=0), drawing) < 0.7
    assert looks_alike(gray, turned + 200, drawing) == 0.0


@pytest.mark.parametrize("turn", [0.5 * np.pi, np.pi, -0.5 * np.pi])
def test_the_first_corner_turns_with_the_tag(turn):
    camera, pose = pinhole((160, 120), 400.0), facing(0, 0, 0.5, (0.0, 0.0, turn))
    markers = detect_markers(photograph(camera, [(2, pose)]), "tag36h11")
    assert np.abs(markers.corners[0] - true_corners(camera, pose)).max() < 0.05  # hundredths are usual


def test_gamma_does_not_make_a_tag_smaller():
    camera, pose = pinhole((160, 120), 500.0), facing(0.0, 0.0, 0.4, (0.3, -0.2, 0.4))
    gray = photograph(camera, [(12, pose)], exposure=Exposure(blur_px=0.7, noise_dn=2.0, gamma=2.2))
    markers = detect_markers(gray, "tag36h11")
    assert np.abs(markers.corners[0] - true_corners(camera, pose)).max() < 0.08  # edges move by 0.3 px


def test_a_tag_that_is_partly_covered_keeps_its_corners():
    camera, pose = pinhole((220, 180), 600.0), facing(0.0, 0.0, 0.3, (0.3, 0.2, 0.1))
    gray = photograph(camera, [(9, pose)])
    gray[78:96, 100:118] = 120  # a finger on some cells within
    markers = detect_markers(gray, "tag36h11")
    assert markers.ids.tolist() == [9]
    assert np.abs(markers.corners[0] - true_corners(camera, pose)).max() < 0.1  # Huber's loss, not a hard cut


def test_texture_without_tags_gives_none():
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 256, (48, 64)).astype(np.uint8)
    gray = cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_NEAREST)  # squares everywhere
    markers = detect_markers(gray, "tag16h5")
    assert markers.ids.size == 0
    assert markers.corners.shape == (0, 4, 2)
    assert markers.covariance.shape == (0, 4, 2, 2)


def test_the_same_image_gives_the_same_corners(scene):
    gray = scene[0][90:230, 130:260]
    once, again = (detect_markers(gray, "tag36h11") for _ in range(2))
    assert once.ids.tolist() == [3]
    assert np.array_equal(once.corners, again.corners)


def test_a_tag_whose_margin_is_cut_off_by_the_rim_is_found():
    camera, pose = pinhole((120, 100), 500.0), facing(0.0, 0.0, 0.5)
    markers = detect_markers(photograph(camera, [(6, pose)])[:, 29:], "tag36h11")  # the tag begins at column 34.5
    assert markers.ids.tolist() == [6]
    assert np.abs(markers.corners[0] - true_corners(camera, pose) + [29, 0]).max() < 0.06  # hundredths are usual


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (0, 0)])
def test_an_image_without_room_for_a_tag_has_none(shape):
    assert detect_markers(np.zeros(shape, np.uint8), "tag36h11").ids.size == 0


def test_other_images_than_gray_ones_of_8_bits_are_refused():
    with pytest.raises(InvalidInput, match="8 bits"):
        detect_markers(np.zeros((10, 10), np.uint16), "tag36h11")
