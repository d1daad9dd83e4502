"""Files, folders, patterns and camera addresses as people type them."""

import os
from pathlib import Path

import pytest

from camcal.errors import FileError, InvalidInput
from camcal.formats import split_address
from camcal.run import fingerprint
from camcal.run.paths import find_images, find_media


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Path("photos")


def fill(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")


def names(paths: list[Path]) -> list[str]:
    return [path.as_posix() for path in paths]


def test_a_folder_is_read_in_natural_order_without_hidden_and_foreign_files(folder):
    fill(folder, "img10.png", "img2.JPG", "img1.dng", "notes.txt", "._img2.JPG", "clip.mp4", "below/img3.png")
    assert names(find_images([folder])) == ["photos/img1.dng", "photos/img2.JPG", "photos/img10.png"]


def test_folders_below_are_read_when_asked(folder):
    fill(folder, "img10.png", "b2/img1.png", "b10/img1.png", ".thumbnails/img1.png")
    expected = ["photos/b2/img1.png", "photos/b10/img1.png", "photos/img10.png"]
    assert names(find_images([folder], recursive=True)) == expected


def test_a_quoted_pattern_gives_what_the_shell_would_give_and_the_order_is_that_of_the_folder(folder):
    fill(folder, "img10.png", "img2.png", "other.png", "img.txt")
    by_shell = find_images(["photos/img10.png", "photos/img2.png"])
    assert find_images(["photos/img*"]) == by_shell
    assert names(by_shell) == ["photos/img2.png", "photos/img10.png"]


def test_a_file_whose_name_looks_like_a_pattern_is_that_file(folder):
    fill(folder, "img[1].png", "img1.png")
    assert names(find_images(["photos/img[1].png"])) == ["photos/img[1].png"]


def test_a_named_file_is_taken_whatever_its_suffix(folder):
    fill(folder, "frame.data")
    assert names(find_images(["photos/frame.data"])) == ["photos/frame.data"]


def test_an_image_named_twice_counts_once_under_its_first_name(folder):
    fill(folder, "a.png", "b.png")
    assert names(find_images(["photos/../photos/a.png", folder, "photos/*.png"])) == [
        "photos/../photos/a.png",
        "photos/b.png",
    ]


def test_of_several_links_to_an_image_the_first_name_counts_in_whatever_order_a_folder_lists_them(folder, monkeypatch):
    fill(folder, "z.png")
    for name in ("b.png", "a10.png", "a9.png"):
        (folder / name).symlink_to("z.png")
    listing = list(folder.iterdir())
    for order in (listing, listing[::-1]):
        monkeypatch.setattr(Path, "iterdir", lambda _, order=order: iter(order))
        assert names(find_images([folder])) == ["photos/a9.png"]
        assert names(find_images([folder / "b.png", folder])) == ["photos/b.png"]


def test_names_of_one_number_have_one_order_too(folder, monkeypatch):
    fill(folder, "a1.png", "a01.png", "A1.png", "a2.png", "a.png")
    listing = list(folder.iterdir())
    for order in (listing, listing[::-1]):
        monkeypatch.setattr(Path, "iterdir", lambda _, order=order: iter(order))
        found = [path.name for path in find_images([folder])]
        assert found == ["A1.png", "a01.png", "a1.png", "a2.png", "a.png"]


def test_videos_are_listed_apart(folder):
    fill(folder, "a.png", "clip.MP4")
    media = find_media([folder])
    assert names(media.images) == ["photos/a.png"]
    assert names(media.videos) == ["photos/clip.MP4"]


def test_a_video_named_where_images_are_needed_is_refused(folder):
    fill(folder, "a.png", "clip.mp4")
    with pytest.raises(FileError, match=r"photos/clip\.mp4: is a video"):
        find_images(["photos/a.png", "photos/clip.mp4"])


def test_images_camcal_wrote_are_left_out_beside_others(folder):
    fill(folder, "a.dng", "a.png", "b.png", "undistorted/a.png")
    fingerprint.change(folder, {"a.png": None})
    fingerprint.change(folder, {"b.png": None})
    fingerprint.change(folder / "undistorted", {"a.png": None})
    assert names(find_images([folder])) == ["photos/a.dng"]
    assert names(find_images([folder], recursive=True)) == ["photos/a.dng"]
    assert names(find_images(["photos/a.*"])) == ["photos/a.dng"]


def test_a_name_that_is_not_utf8_is_remembered_too(folder):
    odd = os.fsdecode(b"caf\xe9.png")
    fill(folder, "a.dng", odd)
    fingerprint.change(folder, {odd: None})
    assert names(find_images([folder])) == ["photos/a.dng"]


def test_no_outputs_leave_no_list(folder):
    fill(folder, "a.png")
    fingerprint.change(folder, {})
    assert [path.name for path in folder.iterdir()] == ["a.png"]


def test_images_camcal_wrote_are_read_when_named_or_alone(folder):
    fill(folder, "a.dng", "a.png", "undistorted/a.png")
    fingerprint.change(folder, {"a.png": None})
    fingerprint.change(folder / "undistorted", {"a.png": None})
    assert names(find_images(["photos/a.png"])) == ["photos/a.png"]
    assert names(find_images([folder / "undistorted"])) == ["photos/undistorted/a.png"]


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ("photos/img_01.png", "photos/img_01.png: no such file. Did you mean 'photos/img_001.png'?"),
        ("photoz/img_001.png", "photoz/img_001.png: no such file. Did you mean 'photos'?"),
        ("qqq", "qqq: no such file"),
        ("photos/*.webp", "photos/*.webp: matches no file"),
        ("photos/*.txt", "photos/*.txt: matches no image (1 .txt)"),
        ("texts", "texts: holds no image (2 .txt, 1 folder, 1 without suffix); --recursive reads the folders below it"),
        ("void", "void: holds no image (it is empty)"),
        ("x" * 300, f"{'x' * 300}: cannot be read: File name too long"),
    ],
)
def test_what_is_missing_is_said_in_one_line(folder, wanted, message):
    fill(folder, "img_001.png", "a.txt")
    fill(Path("texts"), "a.txt", "b.txt", "README", "below/c.txt")
    Path("void").mkdir()
    with pytest.raises(FileError) as caught:
        find_images([wanted])
    assert str(caught.value) == message


def test_no_inputs_are_refused():
    with pytest.raises(InvalidInput, match="no images given"):
        find_images([])


def test_an_address_is_a_file_and_a_camera(folder):
    assert split_address("rig.yaml#left") == (Path("rig.yaml"), "left")
    assert split_address("rig.yaml") == (Path("rig.yaml"), None)


def test_a_file_with_a_number_sign_in_its_name_is_found_first(folder):
    fill(Path(), "rig#2.yaml")
    assert split_address("rig#2.yaml") == (Path("rig#2.yaml"), None)
    assert split_address("rig#2.yaml#left") == (Path("rig#2.yaml"), "left")


@pytest.mark.parametrize("text", ["rig.yaml#", "#left"])
def test_half_an_address_is_refused(text):
    with pytest.raises(InvalidInput, match="addressed as"):
        split_address(text)
