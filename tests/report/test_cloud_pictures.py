"""Pictures and videos of clouds without a screen."""

import cv2
import numpy as np
import pytest
from clouds import BLUE, RED, middle_of, scene_of, square, two_squares
from PIL import Image

from camcal.errors import InvalidInput
from camcal.report.cloud_pictures import (
    draw,
    labels_of,
    montage,
    nice_below,
    picture,
    rendered,
    shading,
    video_frames,
    write_video,
)
from camcal.report.cloud_scene import View, named_views, turn, view_of
from camcal.report.colour_scale import ColourScale, paint_of, scale_of, turbo, turbo_table

SIZE = (240, 180)


@pytest.fixture(scope="module")
def scene():
    return scene_of(*two_squares())


def place(scene, view, size, point):
    """Return the pixel (x, y) at which a view shows a point."""
    right, down, forward = view.axes @ (np.asarray(point) - view.eye)
    scale = view.focal(size) / (view.distance if view.parallel else forward)
    return right * scale + size[0] / 2, down * scale + size[1] / 2


@pytest.mark.parametrize("name", ["camera", "front", "20,10"])
def test_colours_are_where_the_points_are(scene, name):
    view = view_of(name, scene)
    pixels = rendered(scene, paint_of(scene), view, SIZE, 1.0)
    for colour, middle in ((RED, (-0.5, 0.1, 2.0)), (BLUE, (1.0, -0.2, 4.0))):
        x, y, count = middle_of(pixels, colour)
        assert count > 300
        # The centre of mass of a square seen at an angle is not quite where its middle is.
        assert (x, y) == pytest.approx(place(scene, view, SIZE, middle), abs=2.5)


def test_surfaces_look_closed_at_any_size(scene):
    view = named_views(scene)["camera"]
    for size in ((120, 90), (480, 360), (960, 720)):
        shown = draw(scene, view, size).index >= 0
        x, y = place(scene, view, size, (-0.5, 0.1, 2.0))
        left, _ = place(scene, view, size, (-0.79, 0.1, 2.0))
        half = int(x - left)
        assert shown[int(y) - half : int(y) + half, int(x) - half : int(x) + half].all()


def test_what_is_behind_is_hidden():
    front, back = square((0, 0, 2), 0.5, 60), square((0, 0, 3), 0.2, 60)
    scene = scene_of(np.concatenate([back, front]), np.repeat([BLUE, RED], 3600, axis=0))
    pixels = rendered(scene, paint_of(scene), named_views(scene)["camera"], SIZE, 1.0)
    assert middle_of(pixels, RED)[2] > 3000
    assert middle_of(pixels, BLUE)[2] == 0
    behind = rendered(scene, paint_of(scene), view_of("180,0", scene), SIZE, 1.0)
    assert middle_of(behind, BLUE)[2] > 500


def test_larger_points_cover_more():
    scene = scene_of(square((0, 0, 2), 0.5, 12), RED)
    view = named_views(scene)["front"]
    shown = [np.count_nonzero(draw(scene, view, SIZE, factor).index >= 0) for factor in (0.3, 1.0)]
    assert shown[0] < 0.7 * shown[1]


def test_the_distance_of_what_is_drawn_is_that_of_the_points(scene):
    drawn = draw(scene, named_views(scene)["front"], SIZE)
    shown = drawn.index >= 0
    away = named_views(scene)["front"].eye[2]
    np.testing.assert_allclose(drawn.distance[shown], scene.depth[drawn.index[shown]] - away, rtol=1e-6)  # float32
    assert np.isinf(drawn.distance[~shown]).all()


def test_nothing_before_the_viewer_is_an_empty_picture(scene):
    away = View((0, 0, -50), np.pi, 0.0, 1.0, 1.0, 1.0)
    assert (draw(scene, away, SIZE).index == -1).all()


def test_edges_are_darker_than_surfaces():
    distance = np.full((40, 40), 4.0, np.float32)
    distance[:, :20] = 2.0
    factor = shading(distance)
    assert factor[20, 5] == factor[20, 35] == 1
    assert factor[20, 20] < 0.8  # what lies behind the step, beside it
    assert factor[20, 19] == 1


def test_a_legend_and_a_caption_stand_over_the_picture(scene):
    view = named_views(scene)["front"]
    paint = paint_of(scene, "depth")
    bare = rendered(scene, paint, view, SIZE, 1.0)
    whole = picture(scene, paint, "front", SIZE)
    changed = (bare != whole).any(axis=2)
    assert changed[:20, :60].any()  # the caption
    assert changed[-100:, -60:].mean() > 0.3  # the legend
    assert changed[-25:, :70].any()  # the scale bar
    assert not changed[60:100, 100:140].any()
    assert labels_of(scene, paint, view, SIZE, "front").pixels_per_unit == pytest.approx(
        view.focal(SIZE) / view.distance
    )


def test_a_bar_is_a_round_length():
    assert [nice_below(length) for length in (1, 1.99, 2, 7, 0.09, 430)] == pytest.approx([1, 1, 2, 5, 0.05, 200])


def test_depth_goes_from_blue_to_red(scene):
    colours = paint_of(scene, "depth").colours
    near, far = colours[0].astype(int), colours[-1].astype(int)
    assert near[2] > near[0] or near.sum() < 200  # dark blue
    assert far[0] > 2 * far[2]


def test_sigma_and_gray_are_shown(scene):
    assert paint_of(scene, "sigma").scale.low == pytest.approx(0.04, rel=1e-3)
    gray = paint_of(scene, "gray").colours
    assert np.ptp(gray, axis=1).max() == 0
    assert gray[0, 0] == round(0.299 * 220 + 0.587 * 20 + 0.114 * 20)


def test_what_a_cloud_does_not_have_is_refused(scene):
    bare = scene_of(two_squares()[0])
    assert paint_of(bare).name == "depth"
    for colour, said in (("image", "has no colours"), ("sigma", "has no sigma"), ("heat", "is unknown")):
        with pytest.raises(InvalidInput, match=said):
            paint_of(bare, colour)


def test_a_montage_has_four_views(scene):
    whole = montage(scene, paint_of(scene), (402, 302))
    assert whole.shape == (302, 402, 3)
    quarters = [
        whole[rows, columns]
        for rows in (slice(0, 150), slice(152, 302))
        for columns in (slice(0, 200), slice(202, 402))
    ]
    assert all(middle_of(quarter, RED)[2] for quarter in quarters)


@pytest.mark.parametrize("size", [(10, 100), (100, 9000)])
def test_a_size_that_cannot_be_drawn_is_refused(scene, size):
    with pytest.raises(InvalidInput, match="sides of 32 to 8192"):
        picture(scene, paint_of(scene), "front", size)


def test_a_picture_is_the_same_every_time(scene):
    once, again = (picture(scene, paint_of(scene, "depth"), "30,20", SIZE) for _ in range(2))
    np.testing.assert_array_equal(once, again)


def test_a_few_outliers_do_not_stretch_a_scale():
    rng = np.random.default_rng(3)
    scale = scale_of(np.concatenate([rng.uniform(2, 3, 1000), [1e9, -5, np.nan, np.inf]]))
    assert (scale.low, scale.high) == pytest.approx((2.02, 2.98), abs=0.02)
    assert not scale.logarithmic


def test_a_wide_range_is_shown_by_ratios():
    scale = scale_of(np.geomspace(1, 100, 2001))
    assert scale.logarithmic
    np.testing.assert_allclose(
        np.diff(scale.fraction(np.array([2.0, 4, 8, 16]))), np.log(2) / np.log(scale.high / scale.low)
    )


def test_values_that_are_all_the_same_or_missing_have_a_scale():
    assert scale_of(np.full(9, 3.0)).fraction(np.array([3.0])) == pytest.approx([0.5])
    assert scale_of(np.full(9, np.nan)) == ColourScale(0, 1)


def test_turbo_has_gray_for_what_is_not_known():
    assert turbo(np.array([0.0, 1.0, np.nan])).tolist() == [
        turbo_table()[0].tolist(),
        turbo_table()[255].tolist(),
        [128] * 3,
    ]
    assert turbo_table()[0].tolist() == [48, 18, 59]  # the published table begins so


def write_turn(scene, path, size=(160, 120), count=4):
    views = turn(named_views(scene)["camera"], np.radians(40), count)
    write_video(path, video_frames(scene, paint_of(scene), views, size))


def test_a_gif_turns_without_end(scene, tmp_path):
    write_turn(scene, tmp_path / "turn.gif")
    with Image.open(tmp_path / "turn.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"], gif.info["duration"]) == (4, (160, 120), 0, 50)
        frames = []
        for number in range(4):
            gif.seek(number)
            frames.append(np.array(gif.convert("RGB")))
    places = [middle_of(frame, RED)[0] - middle_of(frame, BLUE)[0] for frame in frames]
    # From the right the near square is farther left of the far one than in the middle, from the left less so.
    assert places[1] < places[0] - 3
    assert places[3] > places[0] + 3
    assert places[2] == pytest.approx(places[0], abs=0.5)


def test_an_mp4_has_every_frame(scene, tmp_path):
    write_turn(scene, tmp_path / "turn.mp4")
    video = cv2.VideoCapture(str(tmp_path / "turn.mp4"))
    frames = [video.read()[1] for _ in range(4)]
    assert not video.read()[0]
    assert frames[0].shape == (120, 160, 3)
    assert middle_of(frames[0][:, :, ::-1], RED)[2] > 100


def test_a_video_has_a_size_that_can_be_drawn(scene, tmp_path):
    with pytest.raises(InvalidInput, match="sides of 32 to 8192"):
        write_turn(scene, tmp_path / "turn.gif", size=(2, 2))


def test_an_mp4_with_odd_sides_is_refused_and_leaves_nothing(scene, tmp_path):
    with pytest.raises(InvalidInput, match="even numbers"):
        write_turn(scene, tmp_path / "turn.mp4", size=(161, 120))
    assert not list(tmp_path.iterdir())


def test_a_video_is_the_same_every_time(scene, tmp_path):
    for name in ("one.gif", "two.gif"):
        write_turn(scene, tmp_path / name, count=2)
    assert (tmp_path / "one.gif").read_bytes() == (tmp_path / "two.gif").read_bytes()
