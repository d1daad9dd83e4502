"""The textbook's matcher on real pairs: its errors as published figures and other programs count them."""

import cv2
import pytest

from camcal.formats import disparity
from camcal.images.files import gray_8bit, load
from camcal.stereo.truth import evaluate, visible_in_both


@pytest.fixture
def sgbm():
    """The semi-global matcher with the settings of the textbook's example."""

    def match(left, right):
        matcher = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=64,
            blockSize=9,
            P1=8 * 81,
            P2=32 * 81,
            disp12MaxDiff=1,
            preFilterCap=63,
            uniquenessRatio=10,
            speckleWindowSize=100,
            speckleRange=32,
        )
        return matcher.compute(left, right)

    return match


@pytest.mark.parametrize(
    ("name", "bad1", "bad2", "bad2_all"), [("cones", 14.1, 13.1, 22.9), ("teddy", 19.5, 17.3, 25.9)]
)
def test_the_textbook_matcher_has_the_errors_measured_elsewhere(real_data, tmp_path, sgbm, name, bad1, bad2, bad2_all):
    folder = real_data / "stereo_gt" / f"middlebury2003-{name}"
    counts = sgbm(gray_8bit(load(folder / "im2.png").pixels), gray_8bit(load(folder / "im6.png").pixels))
    cv2.imwrite(str(tmp_path / "sgbm.tiff"), counts)
    truth, right_truth = (disparity.read(folder / f"disp{view}.png", 4.0).matched() for view in (2, 6))
    found = disparity.read(tmp_path / "sgbm.tiff").matched()
    figures = evaluate(found, truth, visible_in_both(truth, right_truth)).figures
    # measured with another program and OpenCV 5.0; rounding of gray values and versions differ by less than this
    assert figures["nocc"]["bad1"] == pytest.approx(bad1, abs=0.4)
    assert figures["nocc"]["bad2"] == pytest.approx(bad2, abs=0.4)
    assert figures["all"]["bad2"] == pytest.approx(bad2_all, abs=0.4)
    assert figures["all"]["density"] < 86  # of 450 columns the matcher leaves out the first 64


def test_the_truth_has_no_errors_against_itself(real_data):
    folder = real_data / "stereo_gt" / "middlebury2014-motorcycleQ"
    truth = disparity.read(folder / "disp0GT.pfm").matched()
    figures = evaluate(truth, truth).figures["all"]
    assert figures["bad0.5"] == 0
    assert figures["density"] == 100
