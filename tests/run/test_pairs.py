"""Which images belong together."""

import pytest

from camcal.errors import FileError, InvalidInput
from camcal.run.paths import find_pairs


@pytest.fixture
def files(tmp_path):
    def make(*names):
        for name in names:
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(b"x")
        return tmp_path

    return make


def names_of(folder, pairs):
    return [tuple(path.relative_to(folder).as_posix() for path in pair) for pair in pairs]


def test_two_files_are_a_pair_whatever_their_names(files):
    folder = files("a.png", "b.png")
    assert names_of(folder, find_pairs([folder / "b.png"], [folder / "a.png"])) == [("b.png", "a.png")]


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("left/{}.png", "right/{}.png"),
        ("left/left_{}.png", "right/right_{}.png"),
        ("a/{}_L.png", "b/{}_R.png"),
        ("a/imgL{}.png", "b/imgR{}.png"),
        ("a/leftImage{}.png", "b/rightImage{}.png"),
        ("a/LEFT-{}.png", "b/RIGHT-{}.png"),
        ("a/frame{}_0.png", "b/frame{}_1.png"),
        ("cam0/{}.png", "cam1/{}.png"),
    ],
)
def test_names_agree_but_for_the_mark_of_the_side(files, left, right):
    numbers = ("2", "10", "3")
    folder = files(*(name.format(number) for name in (left, right) for number in numbers))
    pairs = find_pairs([folder / left.split("/")[0]], [folder / right.split("/")[0]])
    assert names_of(folder, pairs) == [(left.format(n), right.format(n)) for n in ("2", "3", "10")]


def test_patterns_over_the_folders_of_scenes_pair_by_folder(files):
    folder = files(*(f"scene{n}/im{side}.png" for n in (2, 10) for side in (0, 1)))
    pairs = find_pairs([f"{folder}/*/im0.png"], [f"{folder}/*/im1.png"])
    assert names_of(folder, pairs) == [(f"scene{n}/im0.png", f"scene{n}/im1.png") for n in (2, 10)]


def test_one_folder_is_split_by_patterns(files):
    folder = files("left1.png", "right1.png", "left2.png", "right2.png")
    pairs = find_pairs([f"{folder}/left*.png"], [f"{folder}/right*.png"])
    assert names_of(folder, pairs) == [("left1.png", "right1.png"), ("left2.png", "right2.png")]


def test_names_are_matched_and_not_counted(files):
    folder = files("l/2.png", "l/10.png", "r/right_10.png", "r/right_2.png")
    assert names_of(folder, find_pairs([folder / "l"], [folder / "r"])) == [
        ("l/2.png", "r/right_2.png"),
        ("l/10.png", "r/right_10.png"),
    ]


def test_names_with_nothing_in_common_pair_in_natural_order(files):
    folder = files("l/dsc7.png", "l/dsc12.png", "r/p5.png", "r/p31.png")
    assert names_of(folder, find_pairs([folder / "l"], [folder / "r"])) == [
        ("l/dsc7.png", "r/p5.png"),
        ("l/dsc12.png", "r/p31.png"),
    ]


def test_words_that_contain_a_side_are_left_alone(files):
    folder = files("l/bright1.png", "l/color1.png", "r/bright1.png", "r/color1.png")
    assert len(find_pairs([folder / "l"], [folder / "r"])) == 2


def test_another_number_of_images_is_refused_naming_one_without_a_partner(files):
    folder = files("l/1.png", "l/2.png", "l/3.png", "r/1.png", "r/3.png")
    with pytest.raises(InvalidInput, match=r"3 left and 2 right images differ; .*l.2\.png is unpaired"):
        find_pairs([folder / "l"], [folder / "r"])


def test_names_that_agree_in_part_are_refused(files):
    folder = files("l/1.png", "l/2.png", "r/2.png", "r/3.png")
    with pytest.raises(InvalidInput, match=r"have only some names in common; .*l.1\.png is unpaired"):
        find_pairs([folder / "l"], [folder / "r"])


def test_an_image_is_no_pair_with_itself(files):
    folder = files("1.png", "2.png")
    with pytest.raises(InvalidInput, match="as the left and as the right image"):
        find_pairs([folder], [folder])


def test_missing_files_are_named(files):
    folder = files("left.png")
    with pytest.raises(FileError, match=r"right\.png: no such file"):
        find_pairs([folder / "left.png"], [folder / "right.png"])
