"""`camcal demosaic`: files in, images out, and what it says when it cannot."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from camcal.raw.mosaic import sites

CONFIG = Path(__file__).parents[2] / "sample_configs" / "demosaic.yaml"
COLOUR = (40, 90, 200)  # blue, green, red


def mosaic_of_one_colour(pattern="RGGB", size=(9, 6), scale=1):
    mosaic = np.empty(size[::-1], np.uint16 if scale > 1 else np.uint8)
    for level, colour in zip(COLOUR, "BGR", strict=True):
        for site in sites(pattern, colour):
            mosaic[site] = level * scale
    return mosaic


def write(path, image):
    path.parent.mkdir(exist_ok=True)
    np.save(path, image) if path.suffix == ".npy" else cv2.imwrite(str(path), image)
    return path


def read(path):
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".pgm", ".npy"])
@pytest.mark.parametrize("pattern", ["RGGB", "GRBG", "GBRG", "BGGR"])
def test_a_bare_mosaic_becomes_a_colour_image(run, tmp_path, suffix, pattern):
    source = write(tmp_path / f"raw{suffix}", mosaic_of_one_colour(pattern))
    code, out, _ = run("demosaic", source, "--pattern", pattern, "-o", tmp_path / "image.png")
    assert code == 0
    assert f"9x6, {pattern}, black 0, white 255" in out
    np.testing.assert_array_equal(read(tmp_path / "image.png"), np.broadcast_to(COLOUR, (6, 9, 3)))


def test_sixteen_bits_stay_sixteen_bits_in_a_tiff(run, tmp_path):
    source = write(tmp_path / "raw.png", mosaic_of_one_colour(scale=256))
    assert run("demosaic", source, "--pattern", "RGGB", "-o", tmp_path / "images")[0] == 0
    image = read(tmp_path / "images" / "raw.tiff")
    assert image.dtype == np.uint16
    np.testing.assert_array_equal(image[2, 3], np.array(COLOUR) * 256)


def test_floating_point_goes_to_a_numpy_file_between_zero_and_one(run, tmp_path):
    source = write(tmp_path / "raw.png", mosaic_of_one_colour())
    code, _, _ = run("demosaic", source, "--pattern", "RGGB", "--depth", "float", "-o", tmp_path / "image.npy")
    assert code == 0
    np.testing.assert_allclose(np.load(tmp_path / "image.npy")[2, 3], np.array(COLOUR) / 255, rtol=1e-6)  # float32


def test_levels_balance_and_tone_are_applied(run, tmp_path):
    source = write(tmp_path / "raw.png", np.full((4, 4), 64 + 1000, np.uint16))
    options = ["--black", 64, "--white", 4064, "--wb", "2,1,4", "--tone", "power:2", "--depth", "8"]
    assert run("demosaic", source, "--pattern", "RGGB", *options, "-o", tmp_path / "image.png")[0] == 0
    # a quarter of full scale, times 4, 1 and 2, square root
    np.testing.assert_array_equal(read(tmp_path / "image.png")[1, 1], [255, 128, 180])


def test_a_folder_is_developed_as_one_json_document_and_its_outputs_are_not_read_again(run, tmp_path):
    for name in ("frame10", "frame2"):
        write(tmp_path / "raw" / f"{name}.png", mosaic_of_one_colour())
    code, out, _ = run("demosaic", tmp_path / "raw", "--pattern", "RGGB", "-o", tmp_path / "raw" / "out", "--json")
    document = json.loads(out)
    assert code == 0
    assert list(document) == ["schema", "images", "failed"]
    assert document["schema"] == "camcal/demosaic/1"
    assert [Path(image["source"]).name for image in document["images"]] == ["frame2.png", "frame10.png"]
    assert list(document["images"][0]) == ["source", "output", "size", "pattern", "black", "white", "peak", "gains"]
    again = run("demosaic", tmp_path / "raw", "-r", "--pattern", "RGGB", "-o", tmp_path / "second", "--json")
    assert len(json.loads(again[1])["images"]) == 2


def test_one_unreadable_frame_is_reported_and_the_rest_is_written(run, tmp_path):
    write(tmp_path / "raw" / "good.png", mosaic_of_one_colour())
    (tmp_path / "raw" / "bad.png").write_bytes(b"not an image")
    code, out, err = run("demosaic", tmp_path / "raw", "--pattern", "RGGB", "-o", tmp_path / "out")
    assert code == 6
    assert "failed: " in out
    assert "bad.png" in out
    assert err == "camcal: error: 1 of 2 frames failed, the rest is written\n"
    assert (tmp_path / "out" / "good.tiff").exists()
    assert not (tmp_path / "out" / "bad.tiff").exists()


def test_a_failed_frame_stands_in_the_one_json_document(run, tmp_path):
    write(tmp_path / "raw" / "good.png", mosaic_of_one_colour())
    (tmp_path / "raw" / "bad.png").write_bytes(b"not an image")
    code, out, _ = run("demosaic", tmp_path / "raw", "--pattern", "RGGB", "-o", tmp_path / "out", "--json")
    document = json.loads(out)
    assert code == 6
    assert [Path(failure["source"]).name for failure in document["failed"]] == ["bad.png"]
    assert len(document["images"]) == 1


def test_a_single_unreadable_frame_is_a_file_error(run, tmp_path):
    (tmp_path / "bad.dng").write_bytes(b"not a raw file")
    code, out, err = run("demosaic", tmp_path / "bad.dng", "-o", tmp_path / "out.png")
    assert (code, out) == (3, "")
    assert "bad.dng" in err
    assert not (tmp_path / "out.png").exists()


def test_a_missing_pattern_is_asked_for(run, tmp_path):
    source = write(tmp_path / "raw.png", mosaic_of_one_colour())
    code, _, err = run("demosaic", source, "-o", tmp_path / "out.png")
    assert code == 2
    assert "--pattern RGGB|GRBG|GBRG|BGGR" in err


def test_an_algorithm_that_does_not_exist_is_refused_with_those_that_do(run, tmp_path):
    source = write(tmp_path / "raw.png", mosaic_of_one_colour())
    code, _, err = run("demosaic", source, "--pattern", "RGGB", "--algorithm", "ri", "-o", tmp_path / "out.png")
    assert code == 2
    assert "bilinear, none" in err


def test_an_input_is_never_overwritten(run, tmp_path):
    source = write(tmp_path / "raw.tiff", mosaic_of_one_colour())
    before = source.read_bytes()
    for output in (source, tmp_path):
        code, _, err = run("demosaic", source, "--pattern", "RGGB", "-o", output)
        assert code == 2
        assert "not overwritten" in err
    assert source.read_bytes() == before


def test_two_frames_of_one_name_are_refused(run, tmp_path):
    first = write(tmp_path / "raw.png", mosaic_of_one_colour())
    second = write(tmp_path / "raw.pgm", mosaic_of_one_colour())
    code, _, err = run("demosaic", first, second, "--pattern", "RGGB", "-o", tmp_path / "out")
    assert code == 2
    assert "raw.png" in err
    assert "raw.pgm" in err


def test_many_frames_do_not_go_into_one_file(run, tmp_path):
    names = [write(tmp_path / name, mosaic_of_one_colour()) for name in ("a.png", "b.png")]
    assert run("demosaic", *names, "--pattern", "RGGB", "-o", tmp_path / "out.png")[0] == 2


def test_an_output_that_is_not_written_is_refused_with_those_that_are(run, tmp_path):
    source = write(tmp_path / "raw.png", mosaic_of_one_colour())
    code, _, err = run("demosaic", source, "--pattern", "RGGB", "-o", tmp_path / "out.exr")
    assert code == 2
    assert ".tiff" in err


def test_twelve_bit_counts_in_a_sixteen_bit_file_are_pointed_out(run, tmp_path):
    source = write(tmp_path / "raw.png", np.full((4, 4), 4000, np.uint16))
    code, _, err = run("demosaic", source, "--pattern", "RGGB", "-o", tmp_path / "out.png")
    assert code == 0
    assert "--white 4095?" in err


def test_the_images_do_not_depend_on_the_number_of_jobs(run, tmp_path):
    rng = np.random.default_rng(3)
    frames = rng.integers(0, 4096, (3, 40, 60)).astype(np.uint16)
    for index, frame in enumerate(frames):
        write(tmp_path / "raw" / f"{index}.png", frame)
    for name, count in (("one", 1), ("many", 3)):
        options = ["--config", CONFIG, "-j", count, "-q"]
        assert run("demosaic", tmp_path / "raw", *options, "-o", tmp_path / name)[:2] == (0, "")
    for index in range(3):
        assert (tmp_path / "one" / f"{index}.tiff").read_bytes() == (tmp_path / "many" / f"{index}.tiff").read_bytes()
