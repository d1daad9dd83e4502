"""Bad pixels with known truth: injected into dark frames and into mosaics."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError, InsufficientData, InvalidInput
from camcal.images.files import save
from camcal.raw import MONO, PATTERNS
from camcal.raw.calibration_frames import make_map, read_map, repair, write_map
from camcal.raw.mosaic import phases

HEIGHT, WIDTH = 90, 121
SIZE = (WIDTH, HEIGHT)
X_TRANS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"


def some_bad(seed=1, share=0.01, shape=(HEIGHT, WIDTH)):
    return np.random.default_rng(seed).random(shape) < share


def colour_planes(pattern, shape=(HEIGHT, WIDTH)):
    """Return a mosaic, uint16, with a level for every place of the cell, with X-Trans for every colour."""
    values = np.empty(shape, np.uint16)
    for place, site in enumerate(phases(pattern)):
        values[site] = 1000 * (1 + ("RGB".index(pattern[place]) if len(pattern) == 36 else place))
    return values


@pytest.mark.parametrize(
    "name", ["map.txt", ".badpixels", "map.badpixels", "map.png", "map.tiff", "map.pgm", "map.npy"]
)
@pytest.mark.parametrize("share", [0, 0.01])
def test_a_map_comes_back_as_it_was_written(tmp_path, name, share):
    mask = some_bad(share=share)
    write_map(tmp_path / name, mask)
    found = read_map(tmp_path / name, SIZE)
    np.testing.assert_array_equal(found, mask)
    assert not found.flags.writeable


def test_a_map_of_dcraw_has_columns_before_rows_and_comments(tmp_path):
    path = tmp_path / "list"
    path.write_text(
        "# from a long exposure\n\n  10 20 1092344000\n120 0 # stuck\n0\t89\t-5\n10 20 0\n", encoding="utf-8"
    )
    assert np.argwhere(read_map(path, SIZE)).tolist() == [[0, 120], [20, 10], [89, 0]]


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.int64])
def test_a_numpy_mask_may_be_boolean_or_integer(tmp_path, dtype):
    mask = some_bad()
    np.save(tmp_path / "map.npy", mask.astype(dtype))
    np.testing.assert_array_equal(read_map(tmp_path / "map.npy", SIZE), mask)


def test_a_numpy_list_has_x_and_y(tmp_path):
    np.save(tmp_path / "map.npy", np.array([[10, 20], [120, 0]]))
    assert np.argwhere(read_map(tmp_path / "map.npy", SIZE)).tolist() == [[0, 120], [20, 10]]


@given(st.sets(st.tuples(st.integers(0, WIDTH - 1), st.integers(0, HEIGHT - 1)), max_size=20))
def test_every_set_of_pixels_survives_the_text(tmp_path_factory, points):
    path = tmp_path_factory.mktemp("maps") / "map.txt"
    mask = np.zeros((HEIGHT, WIDTH), bool)
    for x, y in points:
        mask[y, x] = True
    write_map(path, mask)
    np.testing.assert_array_equal(read_map(path, SIZE), mask)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 0\n121 3 0\n", r"map\.txt:2: column 121, row 3 is outside the frame of 121 × 90 pixels"),
        ("# x\n1 -2 0\n", r"map\.txt:2: column 1, row -2 is outside"),
        ("1 90\n", r"map\.txt:1: .* row 90"),
        ("1 2 0\n3\n", r"map\.txt:2: expected 'x y' or 'x y time', found '3'"),
        ("1.5 2 0\n", r"map\.txt:1: expected"),
        ("1 2 0 4\n", r"map\.txt:1: expected"),
        ("x y\n", r"map\.txt:1: expected"),
        ("99999999999999999999 1 0\n", r"map\.txt:1: expected"),
    ],
)
def test_a_line_that_fits_no_pixel_is_refused_by_its_number(tmp_path, text, message):
    (tmp_path / "map.txt").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=message):
        read_map(tmp_path / "map.txt", SIZE)


@pytest.mark.parametrize("name", ["map.txt", "map.png", "map.npy"])
@pytest.mark.parametrize("content", [None, b"", b"\x89\xff\x00"])
def test_a_file_that_is_no_map_is_a_file_error(tmp_path, name, content):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(FileError, match=name):
        read_map(tmp_path / name, SIZE)


def test_a_mask_of_another_size_is_refused(tmp_path):
    save(tmp_path / "map.png", np.zeros((WIDTH, HEIGHT), np.uint8))
    np.save(tmp_path / "map.npy", np.zeros((4, 4), bool))
    save(tmp_path / "colour.png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    for name, found in (("map.png", "90 × 121"), ("map.npy", "4 × 4"), ("colour.png", "121 × 90 × 3")):
        with pytest.raises(InvalidInput, match=f"{name}: the bad pixel map is {found}, the frame 121 × 90"):
            read_map(tmp_path / name, SIZE)


def test_a_numpy_list_outside_the_frame_is_refused_by_its_entry(tmp_path):
    np.save(tmp_path / "map.npy", np.array([[1, 2], [3, 90]]))
    with pytest.raises(InvalidInput, match=r"map\.npy: entry 1: column 3, row 90"):
        read_map(tmp_path / "map.npy", SIZE)


def test_floating_point_is_no_map(tmp_path):
    np.save(tmp_path / "map.npy", np.zeros((HEIGHT, WIDTH)))
    with pytest.raises(FileError, match=r"map\.npy"):
        read_map(tmp_path / "map.npy", SIZE)


def test_a_map_is_not_written_to_a_photograph(tmp_path):
    with pytest.raises(InvalidInput, match=r"map\.jpg: .*\.txt"):
        write_map(tmp_path / "map.jpg", some_bad())
    assert not (tmp_path / "map.jpg").exists()


GLOW = 80 * np.exp(-np.hypot(*np.mgrid[:240, :320]) / 90)


def darks(count, hot, unstable=None):
    """Return dark frames with a glow in a corner, amplifiers up to 5 counts apart, and hot pixels 60 counts up."""
    rng = np.random.default_rng(2)
    base = 64 + GLOW + np.tile([[0, 5], [2, 1]], (120, 160)) + 60 * hot
    frames = []
    for _ in range(count):
        frame = base + rng.normal(0, 2, hot.shape)
        if unstable is not None:
            frame += unstable * rng.normal(0, 40, hot.shape)
        frames.append(np.clip(np.rint(frame), 0, 65535).astype(np.uint16))
    return frames


@pytest.mark.parametrize("count", [1, 4, 8])
@pytest.mark.parametrize("pattern", ["RGGB", MONO, X_TRANS])
def test_hot_pixels_are_found_through_glow_and_unequal_amplifiers_and_no_good_one_is(count, pattern):
    hot = some_bad(3, 0.002, (240, 320))
    np.testing.assert_array_equal(make_map(darks(count, hot), pattern), hot)


def test_a_cluster_and_a_column_are_found_whole():
    hot = np.zeros((240, 320), bool)
    hot[100:107, 200:207] = True
    hot[:, 77] = True
    np.testing.assert_array_equal(make_map(darks(3, hot), "RGGB"), hot)


def test_a_pixel_far_below_the_others_is_bad_too():
    frames = darks(3, np.zeros((240, 320), bool))
    for frame in frames:
        frame[30, 40] = 0
    assert np.argwhere(make_map(frames, "RGGB")).tolist() == [[30, 40]]


def test_pixels_of_unsteady_value_are_found_with_six_frames_and_more():
    unstable = some_bad(4, 0.002, (240, 320))
    steady = np.zeros_like(unstable)
    found = make_map(darks(12, steady, unstable=unstable), "RGGB")
    assert not (found & ~unstable).any()
    assert (found & unstable).sum() > 0.95 * unstable.sum()  # their own chance may keep twelve values together


def test_cosmic_rays_are_no_bad_pixels():
    frames = darks(8, np.zeros((240, 320), bool))
    for number, frame in enumerate(frames):
        frame[some_bad(10 + number, 0.001, frame.shape)] = 4000
    hits = np.sum([frame == 4000 for frame in frames], axis=0)
    found = make_map(frames, "RGGB")
    assert (hits == 1).sum() > 500
    assert not found[hits <= 1].any()


def test_a_sensor_with_less_noise_than_one_count_has_no_bad_pixels_for_rounding():
    hot = some_bad(5, 0.001, (240, 320))
    frames = [np.where(frame % 7 == 0, 1, 0).astype(np.uint8) + np.uint8(9) * hot for frame in darks(4, hot)]
    np.testing.assert_array_equal(make_map(frames, "RGGB"), hot)


@pytest.mark.parametrize("shape", [(5, 70), (41, 43), (66, 65)])
def test_a_frame_of_few_blocks_has_a_map_too(shape):
    frame = np.full(shape, 10, np.uint16)
    frame[1, 2] = 200
    assert np.argwhere(make_map([frame], "RGGB")).tolist() == [[1, 2]]


def test_a_frame_of_one_cell_has_nothing_to_stand_out_from():
    assert not make_map([np.array([[10, 10], [200, 10]], np.uint16)], "RGGB").any()


def test_frames_that_are_not_dark_make_no_map():
    rng = np.random.default_rng(6)
    picture = np.where(rng.random((240, 320)) < 0.3, 3000, rng.normal(64, 1, (240, 320))).astype(np.uint16)
    with pytest.raises(InsufficientData, match=r"30% of the pixels are outliers: check that these are dark frames"):
        make_map([picture], "RGGB")


def test_a_map_needs_frames_of_one_size_and_a_cell():
    with pytest.raises(InsufficientData, match="no frames"):
        make_map([], "RGGB")
    with pytest.raises(InvalidInput, match="frame 2"):
        make_map([np.zeros((4, 4), np.uint16), np.zeros((4, 6), np.uint16)], "RGGB")
    with pytest.raises(InvalidInput, match="at least 6 × 6"):
        make_map([np.zeros((4, 8), np.uint16)], X_TRANS)
    with pytest.raises(InvalidInput, match="pattern"):
        make_map([np.zeros((4, 4), np.uint16)], "RGBG")


@pytest.mark.parametrize("pattern", [*PATTERNS, MONO, X_TRANS])
@pytest.mark.parametrize("share", [0.01, 0.2])
def test_bad_pixels_take_the_value_of_their_own_colour(pattern, share):
    truth = np.full((HEIGHT, WIDTH), 700, np.uint16) if pattern == MONO else colour_planes(pattern)
    mask = some_bad(7, share)
    damaged = np.where(mask, np.uint16(65535), truth)
    before = damaged.copy()
    np.testing.assert_array_equal(repair(damaged, mask, pattern), truth)
    np.testing.assert_array_equal(damaged, before)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_a_repaired_pixel_is_the_median_of_the_eight_at_the_same_place_of_the_next_cells(dtype):
    values = np.arange(81).reshape(9, 9).astype(dtype)
    mask = np.zeros((9, 9), bool)
    mask[4, 4] = mask[2, 2] = True
    found = repair(values, mask, "RGGB")
    assert found.dtype == dtype
    assert found[4, 4] == np.median([22, 24, 38, 42, 56, 58, 60])
    assert found[2, 2] == np.median([0, 2, 4, 18, 22, 36, 38]) == 18
    assert np.count_nonzero(found != values) == 2


def test_a_monochrome_pixel_has_its_neighbours_at_once():
    values = np.arange(25, dtype=np.uint16).reshape(5, 5)
    mask = np.zeros((5, 5), bool)
    mask[0, 0] = True
    assert repair(values, mask, MONO)[0, 0] == 5  # of 1, 5 and 6


def test_the_median_between_two_counts_is_rounded_to_one():
    values = np.array([[0, 0, 7, 0, 10]], np.uint16).repeat(2, axis=0)
    mask = np.zeros((2, 5), bool)
    mask[0, 2] = True
    values[0, 0], values[0, 4] = 3, 10
    assert repair(values, mask, "RGGB")[0, 2] == 6  # 6.5, to even


def test_a_smooth_scene_is_repaired_to_a_few_counts():
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    truth = (2000 + 1000 * np.sin(rows / 15) * np.cos(columns / 20)).astype(np.float32)
    mask = some_bad(8, 0.02)
    found = repair(np.where(mask, 0, truth), mask, "GRBG")
    inner = np.s_[2:-2, 2:-2]
    # the curvature 1000 / 15² over two pixels is 9 counts; lost neighbours tilt the median by half a slope of 67 × 2
    assert np.abs(found - truth)[inner].max() < 67
    assert np.median(np.abs(found - truth)[mask]) < 9


def test_a_cluster_is_filled_from_the_nearest_ring_that_has_a_good_pixel():
    truth = colour_planes("RGGB")
    mask = np.zeros(truth.shape, bool)
    mask[20:41, 30:51] = True  # its middle is 11 pixels from the next good one
    np.testing.assert_array_equal(repair(np.where(mask, np.uint16(0), truth), mask, "RGGB"), truth)


@pytest.mark.parametrize(("pattern", "side", "reach"), [("RGGB", 40, 16), (MONO, 20, 8), (X_TRANS, 40, 16)])
def test_an_area_without_good_pixels_nearby_is_refused(pattern, side, reach):
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[10 : 10 + side, 30 : 30 + side] = True
    with pytest.raises(
        InsufficientData, match=rf"without valid neighbour of their colour within {reach} pixels, such as column \d+"
    ):
        repair(np.zeros((HEIGHT, WIDTH), np.uint16), mask, pattern)


def test_a_map_of_another_size_repairs_nothing():
    with pytest.raises(InvalidInput, match="for 121 × 90 pixels, the frame has 40 × 30"):
        repair(np.zeros((30, 40), np.uint16), some_bad(), "RGGB")
