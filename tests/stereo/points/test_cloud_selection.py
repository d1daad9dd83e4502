"""Which pixels become points: ranges, crops, masks, confidence, sigma and strides."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.run.process import over_threads
from camcal.stereo.depth import Frame, StereoImage, frame_named
from camcal.stereo.disparity import Confidence, StereoGeometry
from camcal.stereo.selection import Selection, select

GEOMETRY = StereoGeometry(fx=100.0, fy=100.0, cx=1.0, cy=0.0, baseline=0.84)
ROW = np.array([[84.0, 42.0, 28.0, 21.0]])  # 1, 2, 3 and 4 m


def kept(disparity, frame=None, *, sigma=None, confidence=None, **kwargs):
    image = StereoImage(disparity, GEOMETRY, sigma=sigma, confidence=confidence)
    return select(image, Selection(**{"outliers": "none", **kwargs}), frame or Frame()).kept.tolist()


def test_depth_range_keeps_both_its_ends():
    assert kept(ROW, depth=(2.0, 3.0)) == [[False, True, True, False]]


def test_an_empty_depth_range_is_refused():
    with pytest.raises(InvalidInput, match="3 … 2 m"):
        Selection(depth=(3.0, 2.0))


def test_a_crop_is_in_the_frame_of_the_cloud_and_in_metres():
    ahead = np.array([[1.5, 3.5], [-9, 9], [-9, 9]])
    assert kept(ROW, frame_named("ros", unit="mm"), crop=ahead) == [[False, True, True, False]]
    right = np.array([[0.05, 9], [-9, 9], [-9, 9]])  # x = (u - 1) z / 100: -0.01, 0, 0.03, 0.08
    assert kept(ROW, crop=right) == [[False, False, False, True]]


def test_an_empty_crop_is_refused():
    with pytest.raises(InvalidInput, match="crop is empty"):
        Selection(crop=np.array([[1, 0], [0, 1], [0, 1]]))


def test_points_are_only_where_the_mask_is():
    assert kept(ROW, mask=np.array([[True, False, True, False]])) == [[True, False, True, False]]
    with pytest.raises(InvalidInput, match="the mask is 2 × 1, the disparity map 4 × 1"):
        kept(ROW, mask=np.ones((1, 2), bool))


def test_less_sure_pixels_are_left_out():
    classes = np.array([[Confidence.FILLED, Confidence.SINGLE, Confidence.NEAR, Confidence.AGREED]], np.uint8)
    assert kept(ROW, confidence=classes, min_confidence=Confidence.NEAR) == [[False, False, True, True]]
    with pytest.raises(InvalidInput, match="unknown confidence of the pixels: no sidecar of the map names it"):
        kept(ROW, min_confidence=1)


def test_depths_that_are_not_known_well_enough_are_left_out():
    sigma = np.array([[8.5, 4.1, np.nan, 0.1]], np.float32)  # 10.1, 9.8, unknown and 0.5 % of the disparity
    assert kept(ROW, sigma=sigma, max_sigma=0.1) == [[False, True, False, True]]
    assert kept(ROW, sigma=2.5, max_sigma=0.1) == [[True, True, True, False]]
    with pytest.raises(InvalidInput, match="unknown standard deviation of the disparity: set --sigma-disparity"):
        kept(ROW, max_sigma=0.1)


def test_a_stride_keeps_every_so_many_rows_and_columns():
    found = np.array(kept(np.ones((5, 7)), stride=3))
    assert np.argwhere(found).tolist() == [[0, 0], [0, 3], [0, 6], [3, 0], [3, 3], [3, 6]]


@pytest.mark.parametrize(
    ("change", "message"),
    [({"stride": 0}, "stride of 0"), ({"outliers": "all"}, "use one of organised"), ({"max_sigma": 0.0}, "positive")],
)
def test_what_cannot_be_asked_for_is_refused(change, message):
    with pytest.raises(InvalidInput, match=message):
        Selection(**change)


def test_matches_and_outliers_are_counted():
    disparity = np.full((9, 9), 30.0)
    disparity[0, 0] = np.nan
    disparity[4, 4] = 60.0
    selected = select(StereoImage(disparity, GEOMETRY), Selection(), Frame())
    assert (selected.matched, selected.outliers) == (80, 1)
    assert not selected.kept[4, 4]


def test_lonely_points_are_found_in_space_as_well():
    disparity = np.full((9, 9), 84.0)  # at 1 m points are 1 cm apart
    disparity[4, 4] = 60.0
    image = StereoImage(disparity, GEOMETRY)
    selected = select(image, Selection(outliers="radius", radius=0.03), Frame(unit="mm"))
    assert np.argwhere(~selected.kept).tolist() == [[4, 4]]
    assert selected.outliers == 1


def test_threads_and_blocks_change_nothing():
    disparity = np.random.default_rng(3).integers(0, 5, (40, 30_000)).astype(np.float32)
    image = StereoImage(disparity, GEOMETRY)
    single_matcher = select(image, Selection(), Frame())
    with over_threads(2) as each:
        together = select(image, Selection(), Frame(), each)
    np.testing.assert_array_equal(single_matcher.kept, together.kept)
    assert (single_matcher.matched, single_matcher.outliers) == (together.matched, together.outliers)
    assert 0 < single_matcher.outliers < single_matcher.matched
