"""Which groups of images their names suggest, and which names suggest none."""

import pytest

from camcal.calibrate.several_cameras import name_groups


def names(*patterns, count=4):
    return [pattern.format(index) for pattern in patterns for index in range(1, count + 1)]


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("left{:02}.jpg", "right{:02}.jpg"),
        ("{:03}_L.png", "{:03}_R.png"),
        ("{:03}l.png", "{:03}r.png"),
        ("cam0_{:04}.png", "cam1_{:04}.png"),
        ("frame-{:04}-camera1.png", "frame-{:04}-camera2.png"),
        ("photos/left/{}.png", "photos/right/{}.png"),
        ("left/images/{}.png", "right/images/{}.png"),
        ("IMG_{:04}.JPG", "DSC{:05}.JPG"),
        ("GOPR{:04}.JPG", "2026-11-22 phone {:02}.jpg"),
        ("left.mp4#{:06}", "right.mp4#{:06}"),
    ],
)
def test_images_of_two_cameras_are_two_groups(first, second):
    images = names(first, second)
    groups = name_groups(images)
    assert {frozenset(images[:4]), frozenset(images[4:])} & set(groups)
    assert len(groups) <= 2


def test_of_three_cameras_each_is_a_group():
    images = names("left/{}.png", "middle/{}.png", "right/{}.png", count=5)
    groups = [frozenset(images[start : start + 5]) for start in (0, 5, 10)]
    assert set(name_groups(images)) == set(groups)


@pytest.mark.parametrize(
    "images",
    [
        names("IMG_{:04}.JPG", count=20),
        names("photos/{}.png", count=12),
        names("video.mp4#{:06}", count=40),
        [],
        ["a.png"],
        names("board-{}-of-20.png", count=20),
    ],
    ids=lambda images: images[0] if images else "none",
)
def test_images_that_are_only_numbered_are_one_group(images):
    assert name_groups(images) == ()


@pytest.mark.parametrize(("others", "found"), [(2, 0), (3, 1)])
def test_fewer_than_three_images_are_no_group(others, found):
    images = names("left{}.png", count=8) + names("right{}.png", count=others)
    assert len(name_groups(images)) == found


@pytest.mark.parametrize(("values", "found"), [(4, True), (5, False)])
def test_a_number_of_many_values_counts_images_and_tells_no_cameras(values, found):
    images = [f"set{value}_{index}.png" for value in range(values) for index in range(10, 30)]
    assert bool(name_groups(images)) == found


def test_large_and_small_letters_are_alike():
    images = [*names("LEFT{}.png", count=2), *names("left{}.png", count=2), *names("Right{}.png")]
    assert set(name_groups(images)) & {frozenset(images[:4]), frozenset(images[4:])}
