"""`camcal demosaic`: files in, images out, and what it says when it cannot."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from camcal.raw.mosaic import sites
from camcal.raw.pixel_formats import pack, pixel_format_named
from camcal.raw.reading import read_mosaic

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
    assert f"9x6   {pattern}         0    255" in out
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
    source = write(tmp_path / "raw.png", np.full((4, 4), 64 + 1001, np.uint16))
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
    assert list(document) == ["schema", "images", "reused", "failed", "warnings"]
    assert document["schema"] == "camcal/demosaic/1"
    assert [Path(image["source"]).name for image in document["images"]] == ["frame2.png", "frame10.png"]
    keys = ["source", "output", "settings", "size", "pattern", "black", "white", "peak", "clipped", "gains"]
    assert list(document["images"][0]) == keys
    again = run("demosaic", tmp_path / "raw", "-r", "--pattern", "RGGB", "-o", tmp_path / "second", "--json")
    assert len(json.loads(again[1])["images"]) == 2


def test_one_unreadable_frame_is_reported_and_the_rest_is_written(run, tmp_path):
    write(tmp_path / "raw" / "good.png", mosaic_of_one_colour())
    (tmp_path / "raw" / "bad.png").write_bytes(b"unknown image format")
    code, out, err = run("demosaic", tmp_path / "raw", "--pattern", "RGGB", "-o", tmp_path / "out", "-q")
    assert (code, out) == (6, "")
    failed, error = err.splitlines()
    assert failed.startswith("camcal: failed: ")
    assert "bad.png: " in failed
    assert error == "camcal: error: 1 of 2 frames failed, the rest is written"
    assert (tmp_path / "out" / "good.tiff").exists()
    assert not (tmp_path / "out" / "bad.tiff").exists()


def test_a_failed_frame_stands_in_the_one_json_document(run, tmp_path):
    write(tmp_path / "raw" / "good.png", mosaic_of_one_colour())
    (tmp_path / "raw" / "bad.png").write_bytes(b"unknown image format")
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
    code, _, err = run("demosaic", source, "--pattern", "RGGB", "--algorithm", "menon", "-o", tmp_path / "out.png")
    assert code == 2
    assert "ri, malvar, bilinear" in err


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
    assert "(--white 4095)" in err


def test_ten_bit_counts_declared_as_twelve_bit_are_pointed_out(run, tmp_path):
    source = tmp_path / "frame.raw"
    np.full((6, 8), 1020, "<u2").tofile(source)
    layout = ("--format", "BayerRG12", "--size", "8x6", "-o", tmp_path / "out.png")
    code, _, err = run("demosaic", source, *layout)
    assert code == 0
    assert "largest count 1020 of 4095: the white level may be 1023 (--white 1023)" in err
    assert "--white" not in run("demosaic", source, *layout, "--white", "4095")[2]


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


def coloured_noise(shape, pattern="RGGB", dtype=np.uint16):
    """Return a mosaic with colours that differ and detail in all of them."""
    rng = np.random.default_rng(7)
    mosaic = np.empty(shape)
    for level, colour in zip((0.2, 0.5, 0.3), "RGB", strict=True):
        for site in sites(pattern, colour):
            mosaic[site] = level * rng.uniform(0.5, 1.5, mosaic[site].shape)
    return (mosaic * np.iinfo(dtype).max).astype(dtype)


def repeated(run, tmp_path, first, *arguments):
    """Develop a frame twice, the second time by the settings of the first, and return both files."""
    again = tmp_path / f"again{first.suffix}"
    source, *options = arguments
    assert run("demosaic", source, *options, "-o", first, "-q")[0] == 0
    assert run("demosaic", source, "--config", f"{first}.yaml", "-o", again, "-q")[::2] == (0, "")
    return first.read_bytes(), again.read_bytes()


@pytest.mark.parametrize(
    "options",
    [
        ("--pattern", "RGGB"),
        ("--pattern", "RGGB", "--wb", "gray-world", "--ev", "0.3", "--tone", "srgb", "--depth", "8"),
        ("--pattern", "RGGB", "--wb", "patch:4,4,20,20", "--black", "100,101,102,103", "--white", "60000.5"),
        ("--pattern", "RGGB", "--algorithm", "gray", "--depth", "float"),
        ("--pattern", "RGGB", "--algorithm", "malvar", "--tone", "power:2.2"),
    ],
)
def test_the_settings_beside_an_image_repeat_it_bit_for_bit(run, tmp_path, options):
    source = write(tmp_path / "raw.png", coloured_noise((60, 70)))
    first, second = repeated(run, tmp_path, tmp_path / "image.tiff", source, *options)
    assert first == second


def test_corrections_are_repeated_too(run, tmp_path):
    source = write(tmp_path / "raw.png", coloured_noise((60, 70)))
    dark = write(tmp_path / "darks" / "dark.png", np.full((60, 70), 300, np.uint16))
    flat = write(tmp_path / "flats" / "flat.png", np.full((60, 70), 30000, np.uint16))
    (tmp_path / "bad.txt").write_text("5 7 0\n")
    options = ["--dark", dark, "--flat", flat.parent, "--bad-pixels", tmp_path / "bad.txt", "--pattern", "RGGB"]
    first, second = repeated(run, tmp_path, tmp_path / "image.tiff", source, *options)
    assert first == second


def test_what_was_found_on_the_way_is_noted_beside_the_options(run, tmp_path):
    source = write(tmp_path / "raw.png", coloured_noise((60, 70)))
    arguments = ("--pattern", "RGGB", "--algorithm", "half", "--wb", "gray-world")
    assert run("demosaic", source, *arguments, "-o", tmp_path / "image.tiff", "-q")[0] == 0
    noted = yaml.safe_load((tmp_path / "image.tiff.yaml").read_text())
    assert noted["algorithm"] == "half"
    assert [noted[name] for name in ("pattern", "colour", "tone", "depth")] == ["RGGB", "none", "linear", "16"]
    assert noted["encoding"] == "linear"
    assert len(noted["wb"].split(",")) == 3
    assert noted["x_record"]["image_size"] == [35, 30]
    assert noted["x_record"]["pixel_of_the_mosaic"] == "(2 x + 0.5, 2 y + 0.5)"


def test_a_yaml_that_somebody_else_wrote_is_kept(run, tmp_path):
    source = write(tmp_path / "raw.png", mosaic_of_one_colour())
    (tmp_path / "image.tiff.yaml").write_text("mine: 1\n")
    code, _, err = run("demosaic", source, "--pattern", "RGGB", "-o", tmp_path / "image.tiff")
    assert code == 2
    assert "image.tiff.yaml: exists and was not written by camcal" in err
    assert not (tmp_path / "image.tiff").exists()


def test_green_on_the_wrong_diagonal_is_refused_with_the_likely_patterns(run, tmp_path):
    source = write(tmp_path / "raw.png", coloured_noise((240, 320)))
    code, _, err = run("demosaic", source, "--pattern", "GRBG", "-o", tmp_path / "image.tiff")
    assert code == 2
    assert "RGGB or BGGR" in err
    assert run("demosaic", source, "--pattern", "GRBG", "--trust-pattern", "-o", tmp_path / "image.tiff")[0] == 0


def test_a_thumbnail_of_every_pattern_is_written(run, tmp_path):
    source = write(tmp_path / "raw.png", coloured_noise((240, 320)))
    code, out, _ = run("demosaic", source, "--preview-patterns", "-o", tmp_path / "previews")
    assert code == 0
    assert "RGGB or BGGR" in out
    names = sorted(path.name for path in (tmp_path / "previews").glob("*.png"))
    assert names == ["raw_BGGR.png", "raw_GBRG.png", "raw_GRBG.png", "raw_RGGB.png"]
    red_first, blue_first = (read(tmp_path / "previews" / name).astype(int) for name in names[::3])
    np.testing.assert_array_equal(red_first, blue_first[..., ::-1])


def test_a_map_of_bad_pixels_is_made_of_dark_frames(run, tmp_path):
    rng = np.random.default_rng(5)
    for index in range(3):
        dark = rng.normal(100, 3, (64, 80)).round().astype(np.uint16)
        dark[[10, 33], [20, 41]] = 2000
        write(tmp_path / "darks" / f"{index}.png", dark)
    code, out, _ = run(
        "demosaic", tmp_path / "darks", "--make-bad-pixel-map", "--pattern", "RGGB", "-o", tmp_path / "bad.txt"
    )
    assert code == 0
    assert "2 of 5120 bad pixels in 3 dark frames" in out
    lines = [line.split()[:2] for line in (tmp_path / "bad.txt").read_text().splitlines() if not line.startswith("#")]
    assert sorted(lines) == [["20", "10"], ["41", "33"]]


def test_a_dng_keeps_the_counts_of_a_bare_mosaic(run, tmp_path):
    mosaic = coloured_noise((64, 80), "GBRG")
    source = write(tmp_path / "raw.png", mosaic)
    assert run("demosaic", source, "--pattern", "GBRG", "--white", 60000, "-o", tmp_path / "raw.dng", "-q")[0] == 0
    frame = read_mosaic(tmp_path / "raw.dng")
    np.testing.assert_array_equal(frame.values, mosaic)
    assert (frame.pattern, frame.white) == ("GBRG", 60000)


def test_a_header_less_frame_is_unpacked(run, tmp_path):
    counts = (coloured_noise((48, 64)) >> 4).astype(np.uint16)
    (tmp_path / "frame.raw").write_bytes(pack(counts, pixel_format_named("BayerRG12p")))
    arguments = ("--format", "BayerRG12p", "--size", "64x48", "--algorithm", "none", "--depth", "16")
    code, out, _ = run("demosaic", tmp_path / "frame.raw", *arguments, "-o", tmp_path / "image.png")
    assert code == 0
    assert out.splitlines()[2].split()[:5] == ["image.png", "64x48", "RGGB", "0", "4095"]
    np.testing.assert_allclose(read(tmp_path / "image.png") / 65535, counts / 4095, atol=1e-5)


def test_layouts_that_fit_a_header_less_file_are_offered(run, tmp_path):
    (tmp_path / "frame.raw").write_bytes(bytes(640 * 480 * 2))
    code, _, err = run("demosaic", tmp_path / "frame.raw", "--pattern", "RGGB", "-o", tmp_path / "image.png")
    assert code == 2
    assert "640x480" in err


def test_a_layout_for_a_file_that_says_its_own_is_refused(run, tmp_path):
    source = write(tmp_path / "raw.png", mosaic_of_one_colour())
    for layout in (("--format", "BayerRG8"), ("--size", "9x6")):
        code, _, err = run("demosaic", source, "--pattern", "RGGB", *layout, "-o", tmp_path / "out.png")
        assert code == 2
        assert "for .raw and .bin files" in err


def test_a_pixel_format_that_does_not_exist_is_refused_with_the_nearest(run, tmp_path):
    code, _, err = run("demosaic", tmp_path / "any.raw", "--format", "BayerRG12q", "-o", tmp_path / "out.png")
    assert code == 2
    assert "did you mean BayerRG12?" in err
