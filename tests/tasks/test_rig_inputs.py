"""Which inputs are of which camera, and which images belong together."""

from pathlib import Path

import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput
from camcal.targets.detection import BoardDetection
from camcal.tasks.rigs.camera_inputs import cameras_of, split_by_name
from camcal.tasks.rigs.matching import matched


def made(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    return folder


def names_of(cameras):
    return {camera.name: [path.name for path in camera.images] for camera in cameras}


def views(camera, *images, times=None):
    stamps = times or [None] * len(images)
    return [
        BoardDetection(image, (640, 480), camera=camera, time=time) for image, time in zip(images, stamps, strict=True)
    ]


def rows(found):
    return [tuple(None if view is None else Path(view.image).name for view in row) for row in found.captures.views]


def test_named_folders_patterns_and_files_are_those_of_their_cameras(tmp_path):
    made(tmp_path, "a/1.png", "a/2.png", "b/x1.png", "b/x2.png", "b/y.png")
    cameras, lines = cameras_of([f"left={tmp_path}/a", f"right={tmp_path}/b/x*.png", f"right={tmp_path}/b/y.png"])
    assert names_of(cameras) == {"left": ["1.png", "2.png"], "right": ["x1.png", "x2.png", "y.png"]}
    assert lines == ()


@pytest.mark.parametrize(
    ("files", "inputs", "expected"),
    [
        (("left/1.png", "right/1.png"), ("left", "right"), ["left", "right"]),
        (("left1.png", "right1.png"), ("left*.png", "right*.png"), ["left", "right"]),
        (("cam0/data/1.png", "cam1/data/1.png"), ("cam0/data", "cam1/data"), ["cam0", "cam1"]),
        (("0/1.png", "1/1.png"), ("0", "1"), ["cam0", "cam1"]),
        (("left.mp4", "right.mp4"), ("left.mp4", "right.mp4"), ["left", "right"]),
    ],
)
def test_inputs_without_names_are_named_by_their_folders_or_patterns(tmp_path, files, inputs, expected):
    made(tmp_path, *files)
    cameras, lines = cameras_of([f"{tmp_path}/{text}" for text in inputs])
    assert [camera.name for camera in cameras] == expected
    assert lines == (f"cameras by the names of their inputs: {', '.join(expected)}",)


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        (["left01", "left02", "left03", "right01", "right02", "right03"], ["left", "right"]),
        (["01_l", "02_l", "01_r", "02_r"], ["left", "right"]),
        (["imgL01", "imgL02", "imgR01", "imgR02"], ["left", "right"]),
        (["cam0_000", "cam0_001", "cam1_000", "cam1_001", "cam2_000", "cam2_001"], ["cam0", "cam1", "cam2"]),
        ([f"{n}_{k}" for n in ("front", "rear", "side") for k in (1, 2, 3)], ["front", "rear", "side"]),
        ([f"{n}_{k:02}" for n in (0, 1) for k in range(5)], ["cam0", "cam1"]),
        (["left01", "left02", "left03", "right01", "right03", "right04"], ["left", "right"]),
    ],
)
def test_one_folder_is_sorted_by_the_part_of_the_names_that_is_the_cameras(files, expected):
    groups = split_by_name([Path(f"{name}.png") for name in sorted(files)])
    assert list(groups) == expected
    assert sum(map(len, groups.values())) == len(files)


@pytest.mark.parametrize("files", [["IMG_0001", "IMG_0002", "IMG_0003"], ["a", "bb", "ccc"], ["left01"]])
def test_names_that_tell_no_cameras_apart_are_not_sorted(files):
    assert split_by_name([Path(f"{name}.png") for name in files]) is None


def test_a_folder_of_folders_has_a_camera_in_each(tmp_path):
    made(tmp_path, "one/1.png", "two/1.png", "notes/readme.txt", "readme.txt")
    cameras, _ = cameras_of([str(tmp_path)])
    assert names_of(cameras) == {"one": ["1.png"], "two": ["1.png"]}


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        (("left={0}/a", "{0}/b"), "some inputs name their camera and this one does not"),
        (("left={0}/a",), "all images are of camera 'left'"),
        (("left={0}/a", "right={0}/a"), "is given for camera 'left' and for camera 'right'"),
        (("9={0}/a", "b={0}/b"), "'9' is not a valid name of a camera"),
        (("a_T_b={0}/a", "b={0}/b"), "is not a valid name of a camera"),
        (("{0}/a",), "do not tell which camera took them"),
        (("=x", "b={0}/b"), "no name in '=x'"),
        (("{0}/one.mp4",), "is the video of one camera"),
        ((), "no images given"),
    ],
)
def test_inputs_that_leave_the_cameras_open_are_refused(tmp_path, inputs, message):
    made(tmp_path, "a/1.png", "a/2.png", "b/1.png", "one.mp4")
    with pytest.raises(InvalidInput, match=message):
        cameras_of([text.format(tmp_path) for text in inputs])


def test_a_pattern_over_folders_has_a_camera_in_each(tmp_path):
    made(tmp_path, "one/1.png", "one/2.png", "two/1.png")
    cameras, _ = cameras_of([f"{tmp_path}/*/*.png"])
    assert names_of(cameras) == {"one": ["1.png", "2.png"], "two": ["1.png"]}


def test_folders_of_sessions_are_no_cameras_where_the_names_tell_them(tmp_path):
    made(tmp_path, "mon/left1.png", "mon/right1.png", "tue/left1.png", "tue/right1.png")
    cameras, _ = cameras_of([f"{tmp_path}/*/*.png"])
    assert names_of(cameras) == {"left": ["left1.png"] * 2, "right": ["right1.png"] * 2}
    found = matched({camera.name: views(camera.name, *map(str, camera.images)) for camera in cameras})
    assert rows(found) == [("left1.png", "right1.png")] * 2
    assert all(len({Path(view.image).parent for view in row}) == 1 for row in found.captures.views)


def test_a_folder_of_videos_has_a_camera_for_each(tmp_path):
    made(tmp_path, "front.mp4", "gopro.mp4")
    cameras, _ = cameras_of([str(tmp_path)])
    assert [(camera.name, len(camera.videos)) for camera in cameras] == [("front", 1), ("gopro", 1)]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        cameras_of([f"left={tmp_path}/lft", f"right={tmp_path}"])


@pytest.mark.parametrize(
    ("left", "right", "expected"),
    [
        (["a/01.png", "a/02.png"], ["b/02.png", "b/01.png"], [("01.png", "01.png"), ("02.png", "02.png")]),
        (["left1.png", "left10.png", "left2.png"], ["right1.png", "right2.png", "right3.png"], None),
        (["x_left_01.png", "x_left_02.png"], ["x_right_01.png", "x_right_02.png"], None),
        (["l/frame_1.png", "l/frame_2.png"], ["r/img-0001.png", "r/img-0002.png"], None),
        (["s1/left.png", "s2/left.png"], ["s1/right.png", "s2/right.png"], None),
    ],
)
def test_images_are_matched_by_their_names_without_the_cameras(left, right, expected):
    found = matched({"left": views("left", *left), "right": views("right", *right)})
    assert found.by == "name"
    if expected:
        assert rows(found) == expected
    shared = [row for row in found.captures.views if None not in row]
    digits = [["".join(filter(str.isdigit, view.image)).lstrip("0") for view in row] for row in shared]
    assert all(one == other for one, other in digits)
    assert len(shared) >= 2


def test_images_without_a_partner_are_captures_of_their_own_and_listed():
    found = matched({"a": views("a", "1.png", "2.png", "3.png"), "b": views("b", "x/1.png", "x/3.png", "x/4.png")})
    assert rows(found) == [("1.png", "1.png"), ("2.png", None), ("3.png", "3.png"), (None, "4.png")]
    assert found.unmatched == ("2.png", "x/4.png")
    assert found.captures.names == ("1", "2", "3", "4")
    assert found.line == "2 captures of 2 cameras, matched by name; 2 images unmatched"


def test_numbers_of_sessions_are_no_numbers_of_images():
    found = matched({"a": views("a", "a/s1_01.png", "a/s1_02.png"), "b": views("b", "b/s1_01.png", "b/s2_01.png")})
    assert rows(found)[0] == ("s1_01.png", "s1_01.png")
    assert len(found.unmatched) == 2


def test_counts_that_agree_are_matched_by_index_where_names_say_nothing():
    found = matched({"a": views("a", "dsc1.png", "dsc5.png"), "b": views("b", "p17.png", "p23.png")})
    assert found.by == "index"
    assert rows(found) == [("dsc1.png", "p17.png"), ("dsc5.png", "p23.png")]


def test_counts_that_differ_and_no_common_names_are_refused():
    some = {"a": views("a", "dsc1.png", "dsc5.png"), "b": views("b", "p17.png", "p23.png", "p99.png")}
    with pytest.raises(InvalidInput, match="too little in common, and their counts differ: a 2"):
        matched(some)
    assert len(matched(some, "index").captures) == 3
    with pytest.raises(InvalidInput, match="no two cameras have images of one name"):
        matched(some, "name")
    with pytest.raises(InvalidInput, match="has no time"):
        matched(some, "time")


def test_three_cameras_with_times_of_their_own_are_matched_to_the_nearest():
    rng = np.random.default_rng(1)
    clock = np.arange(40) * 0.1
    stamps = {
        name: clock + shift + rng.uniform(-0.01, 0.01, 40) for name, shift in (("a", 0), ("b", 0.02), ("c", -0.015))
    }
    kept = {name: np.flatnonzero(rng.random(40) < 0.8) for name in stamps}
    seen = {
        name: views(name, *(f"{name}{index}" for index in kept[name]), times=stamps[name][kept[name]].tolist())
        for name in stamps
    }
    found = matched(seen)
    assert found.by == "time"
    assert found.largest < 0.056
    for row in found.captures.views:
        assert len({view.image[1:] for view in row if view is not None}) == 1
    assert matched(seen, tolerance=0.5).largest > 0.056


def test_clocks_that_have_nothing_in_common_are_refused():
    seen = {"a": views("a", "1", "2", times=[0.0, 1.0]), "b": views("b", "1", "2", times=[100.0, 101.0])}
    with pytest.raises(InvalidInput, match="no two cameras have images within 500 ms"):
        matched(seen)


def test_names_that_half_of_the_images_share_tell_the_captures_and_fewer_do_not():
    left = views("left", "one.png", "two.png", "three.png", "ax.png", "be.png")
    right = views("right", "one.png", "two.png", "quay.png", "mole.png", "zoo.png")
    assert matched({"left": left, "right": right}).by == "index"
    right = views("right", "one.png", "two.png", "three.png", "mole.png", "zoo.png")
    assert matched({"left": left, "right": right}).by == "name"


def test_of_two_images_of_a_camera_within_the_tolerance_the_later_one_begins_another_capture():
    left, right = views("left", "l0", "l1", times=[0.0, 0.4]), views("right", "r0", times=[0.5])
    found = matched({"left": left, "right": right}, tolerance=1.0)
    assert rows(found) == [("l0", None), ("l1", "r0")]
    assert found.unmatched == ("l0",)
