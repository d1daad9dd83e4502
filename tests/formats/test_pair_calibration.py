"""calib.txt of Middlebury, ETH3D and KITTI: the geometry they describe, and the line of what is wrong in them."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import CamcalError, FileError, InvalidInput
from camcal.formats import pair_calibration
from camcal.stereo.disparity import StereoGeometry

MIDDLEBURY = """cam0=[999.421 0 294.182; 0 999.421 252.932; 0 0 1]
cam1=[999.421 0 326.96; 0 999.421 252.932; 0 0 1]
doffs=32.778
baseline=193.001
width=741
height=497
ndisp=70
"""
# Sequence 00 of KITTI's odometry benchmark.
KITTI = """P0: 718.856 0 607.1928 0 0 718.856 185.2157 0 0 0 1 0
P1: 718.856 0 607.1928 -386.1448 0 718.856 185.2157 0 0 0 1 0
P2: 718.856 0 607.1928 45.38225 0 718.856 185.2157 -0.1130887 0 0 1 0.003779761
P3: 718.856 0 607.1928 -337.2877 0 718.856 185.2157 2.369057 0 0 1 0.004915215
Tr: 0 -1 0 -0.01 0 0 -1 -0.07 1 0 0 -0.3
"""


def read(tmp_path, text, left=None):
    (tmp_path / "calib.txt").write_text(text, encoding="utf-8")
    return pair_calibration.read(tmp_path / "calib.txt", left)


def test_middlebury_gives_metres_and_the_size(tmp_path):
    found = read(tmp_path, MIDDLEBURY)
    assert found.geometry == StereoGeometry(999.421, 999.421, 294.182, 252.932, 0.193001, 32.778)
    assert found.image_size == (741, 497)


def test_eth3d_without_a_size_is_read(tmp_path):
    text = "cam0=[500 0 300; 0 500 200; 0 0 1]\ncam1=[500 0 300; 0 500 200; 0 0 1]\ndoffs=0\nbaseline=59.8\n"
    found = read(tmp_path, text)
    assert found.geometry.baseline == pytest.approx(0.0598)
    assert found.image_size is None


@pytest.mark.parametrize(("left", "baseline"), [("P0", 386.1448 / 718.856), ("P2", 0.5327)])
def test_kitti_gives_the_pair_that_is_named(tmp_path, left, baseline):
    found = read(tmp_path, KITTI, left)
    # P2 and P3 lie 1 mm apart along the axis, which moves the centres by cx / fx of that across: 1 mm
    assert found.geometry.baseline == pytest.approx(baseline, abs=1.2e-3)
    assert (found.geometry.fx, found.geometry.cx, found.geometry.doffs) == (718.856, 607.1928, 0)


def test_the_rectified_cameras_of_a_raw_kitti_drive_are_the_same(tmp_path):
    text = "calib_time: 09-Jan-2012 13:57:47\nS_rect_00: 1242 375\n"
    text += KITTI.replace("P0:", "P_rect_00:").replace("P1:", "P_rect_01:").replace("P2:", "P_rect_02:")
    found = read(tmp_path, text, "P0")
    assert found.geometry == read(tmp_path, KITTI, "P0").geometry
    assert found.image_size == (1242, 375)


def test_two_pairs_need_a_name_and_one_does_not(tmp_path):
    with pytest.raises(InvalidInput, match=r"P0 \(gray\) or P2 \(colour\)"):
        read(tmp_path, KITTI)
    assert read(tmp_path, "\n".join(KITTI.splitlines()[:2])).geometry == read(tmp_path, KITTI, "P0").geometry


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("doffs=32.778\n", "", "calib.txt: has no doffs"),
        ("doffs=32.778", "doffs=3.2", "calib.txt:3: doffs is 3.2, but cx of cam1 less cx of cam0 is 32.778"),
        ("baseline=193.001", "baseline=far", "calib.txt:4: baseline needs 1 number, found 'far'"),
        ("baseline=193.001", "baseline=-193", "calib.txt:4: baseline must be positive"),
        ("baseline=193.001", "baseline=nan", "calib.txt:4: baseline needs 1 number"),
        ("cam1=[999.421", "cam1=[990", "differ in focal length"),
        ("cam1=[999.421 0 326.96; 0 999.421 252.932; 0 0 1]", "cam1=999.421", "calib.txt:2: cam1 is not written as"),
        ("cam0=[999.421 0", "cam0=[999.421 0.1", "calib.txt:1: is not the camera matrix"),
        ("cam0=[999.421 0", "cam0=[0 0", "calib.txt:1: is not the camera matrix"),
        ("width=741", "width=74.1", "calib.txt:5: width 74.1 is not a number of pixels"),
        ("height=497\n", "", "has no height"),
        ("ndisp=70", "doffs=32.778", "calib.txt:7: doffs duplicate key"),
    ],
)
def test_what_is_wrong_in_a_middlebury_file_is_named_with_its_line(tmp_path, old, new, message):
    assert old in MIDDLEBURY
    with pytest.raises(InvalidInput) as caught:
        read(tmp_path, MIDDLEBURY.replace(old, new))
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "left", "message"),
    [
        ("P1:", "Q1:", "P0", "has no P1"),
        ("P0: 718.856", "P0:", "P0", "calib.txt:1: P0 needs 12 numbers"),
        ("-386.1448", "386.1448", "P0", "calib.txt:2: baseline must be positive"),
        ("-386.1448 0 718.856", "-386.1448 0 700", "P0", "calib.txt:2: P1 differs from P0"),
        ("2.369057", "23.69057", "P2", "m off the row of P2"),
        ("P0:", "P0:", "P1", "the left camera is P0 or P2, found 'P1'"),
    ],
)
def test_what_is_wrong_in_a_kitti_file_is_named_with_its_line(tmp_path, old, new, left, message):
    assert old in KITTI
    with pytest.raises(InvalidInput) as caught:
        read(tmp_path, KITTI.replace(old, new), left)
    assert message in str(caught.value)


def test_a_name_of_a_camera_is_refused_where_there_is_one_pair(tmp_path):
    with pytest.raises(InvalidInput, match="no camera 'P0'"):
        read(tmp_path, MIDDLEBURY, "P0")


@pytest.mark.parametrize("text", ["fx: 700\n", "some words\n", "", "%YAML 1.1\n---\n"])
def test_another_text_file_is_a_file_error(tmp_path, text):
    with pytest.raises(FileError, match=r"calib\.txt"):
        read(tmp_path, text)


@given(text=st.text(alphabet=st.sampled_from("camP01=[;] :.\n-edx"), max_size=60), line=st.integers(0, 6))
def test_no_text_brings_down_the_reader(tmp_path_factory, text, line):
    lines = MIDDLEBURY.splitlines()
    lines[line] = text
    with suppress(CamcalError):
        assert read(tmp_path_factory.mktemp("pair"), "\n".join(lines)).geometry.fx == 999.421
