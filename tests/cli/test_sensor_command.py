"""`camcal sensor` as it is called from a shell, on frames that `camcal simulate --raw` made."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from camcal.formats import documents
from camcal.formats.native_entry import SENSOR
from camcal.formats.schema import mapping
from camcal.images.files import load, save
from camcal.raw.dng import write_dng
from camcal.raw.mosaic import Capture, Mosaic
from camcal.raw.pixel_formats import pack, pixel_format_named
from camcal.simulate.mosaics import FixedPattern, RawCamera, Shot, even_frame, exposure_series
from camcal.simulate.options import Sensor
from camcal.tasks.simulation.options import RawOptions, SimulateOptions
from camcal.tasks.simulation.simulate import simulate

KEYS = [
    "schema",
    "output",
    "image_size",
    "iso",
    "levels",
    "sensor",
    "saturation",
    "rounding_limited",
    "figures",
    "dynamic_range_stops",
    "phases",
    "warnings",
]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A folder of simulated flats and darks of a sensor of 0.5 counts per electron."""
    folder = tmp_path_factory.mktemp("sensor") / "scene"
    raw = RawOptions("RGGB", Sensor(0.5, 3.0, 7000.0, 32.0, 12), (0.5, 1.0, 0.6), flats=8, darks=8)
    simulate(SimulateOptions(folder, "chessboard:7x5:25mm", size=(160, 120), views=1, jobs=1, raw=raw))
    return folder


@pytest.fixture
def bench(scene, tmp_path):
    """A copy that a test may change."""
    return shutil.copytree(scene, tmp_path / "bench")


def call(run, folder, output, *options):
    darks = () if "--dark" in options else ("--dark", folder / "darks")
    common = ("--pattern", "RGGB", "--jobs", "1", "-o", output)
    return run("sensor", folder / "flats", *darks, *common, *options)


def renamed(folder, kind, name):
    """Move all frames of a kind into one folder whose name may tell something or not."""
    target = folder / name
    target.mkdir()
    for path in sorted((folder / kind).rglob("*.png")):
        path.rename(target / path.name)
    shutil.rmtree(folder / kind)
    return target


def test_a_sensor_file_is_written_and_its_block_fits_a_camera_file(run, scene, tmp_path):
    output = tmp_path / "sensor.yaml"
    code, out, err = call(run, scene, output, "--sensor-format", "1/2.8")
    assert (code, err) == (0, "")
    assert "8 illumination levels, 2 dark levels, 160x120" in out
    assert "saturation at the full well" in out
    data = documents.load(output, lambda _data, _path: ()).data
    assert list(mapping({}, SENSOR)(data["sensor"], "sensor")) == []
    assert data["sensor"]["gain_e_per_dn"] == pytest.approx(2.0, rel=0.03)  # 4 800 samples a phase: 0.5 %
    assert data["sensor"]["pixel_pitch_um"] == pytest.approx(6389 / 200, rel=1e-3)
    assert "bits" not in data["sensor"]  # a file of 16 bits whose largest count is 3 540
    assert data["format"] == "camcal-sensor"
    assert list(data["curves"]) == ["R", "Gr", "Gb", "B"]
    assert len(data["provenance"]["images"]) == 24
    assert data["provenance"]["command"].endswith("darks --pattern RGGB --sensor-format 1/2.8")


def test_a_white_level_gives_the_bits(run, scene, tmp_path):
    code, out, _ = call(run, scene, tmp_path / "sensor.yaml", "--white", "4095", "--json")
    assert code == 0
    assert json.loads(out)["sensor"]["bits"] == 12


def test_json_is_one_document_with_a_frozen_schema(run, scene, tmp_path):
    code, out, err = call(run, scene, tmp_path / "sensor.yaml", "--json", "--plot", tmp_path / "plot.svg")
    document = json.loads(out)
    assert (code, err) == (0, "")
    assert list(document) == [*KEYS[:2], "plot", *KEYS[2:]]
    assert document["schema"] == "camcal/sensor/1"
    assert document["levels"] == {"flat": 8, "dark": 2}
    assert document["figures"]["read_noise_e"]["value"] == pytest.approx(3.0, rel=0.05)
    assert set(document["figures"]["gain_dn_per_e"]) == {"value", "std"}
    assert (tmp_path / "plot.svg").read_text().startswith("<?xml")


@pytest.mark.slow
def test_figures_are_written_to_a_folder_and_listed(run, scene, tmp_path):
    figures = tmp_path / "figures"
    code, out, _ = call(run, scene, tmp_path / "sensor.yaml", "--json", "--figures", figures, "--figure-format", "svg")
    document = json.loads(out)
    names = {"photon_transfer", "signal_to_noise", "linearity"}
    assert (code, {Path(path).stem for path in document["figure_files"]}) == (0, names)
    assert "read_noise_e" in document["figures"]
    assert run("plot", tmp_path / "sensor.yaml", "-o", tmp_path / "again")[0] == 0
    assert {path.stem for path in (tmp_path / "again").glob("*.png")} == names - {"linearity"}


def test_the_same_frames_give_the_same_bytes_whatever_the_jobs(run, scene, tmp_path):
    for name, jobs in (("one", 1), ("two", 2)):
        call(run, scene, tmp_path / name, "--jobs", jobs, "--quiet")
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_frames_in_one_folder_are_sorted_by_their_brightness(run, bench, scene, tmp_path):
    flats, darks = renamed(bench, "flats", "light"), renamed(bench, "darks", "night")
    common = ("--pattern", "RGGB", "--json", "-o", tmp_path / "sensor.yaml")
    code, out, _ = run("sensor", flats, "--dark", darks, *common)
    document = json.loads(out)
    _, out, _ = call(run, scene, tmp_path / "known.yaml", "--json")
    known = json.loads(out)
    assert code == 0
    assert document["levels"] == {"flat": 8, "dark": 1}
    assert "linearity_error" in known["figures"]
    assert "linearity_error" not in document["figures"]
    assert document["figures"]["gain_dn_per_e"]["value"] == pytest.approx(
        known["figures"]["gain_dn_per_e"]["value"], rel=0.01
    )


def test_exposures_can_be_given_for_each_input(run, scene, tmp_path):
    folders = sorted((scene / "flats").iterdir(), key=lambda path: float(path.name[:-2]))[2:5]
    told = ",".join(str(float(path.name[:-2]) * 2e-3) for path in folders)
    code, out, _ = run(
        "sensor", *folders, "--dark", scene / "darks", "--pattern", "RGGB", "--exposure", told, "-o",
        tmp_path / "sensor.yaml", "--json",
    )  # fmt: skip
    assert code == 0
    assert json.loads(out)["levels"] == {"flat": 3, "dark": 2}
    exposures = documents.load(tmp_path / "sensor.yaml", lambda _data, _path: ()).data["curves"]["R"]["exposure_s"]
    assert ",".join(f"{value:g}" for value in exposures) == ",".join(f"{float(value):g}" for value in told.split(","))


def test_two_flats_and_two_darks_are_enough(run, scene, tmp_path):
    flats = sorted((scene / "flats").iterdir(), key=lambda path: float(path.name[:-2]))[4]
    darks = sorted((scene / "darks").rglob("*.png"))[:2]
    options = ("--dark", darks[0], "--dark", darks[1], "--dark-exposure", "0.002", "--pattern", "RGGB")
    code, out, err = run("sensor", flats, *options, "--white", "4095", "-o", tmp_path / "s.yaml", "--json")
    assert code == 0
    assert json.loads(out)["saturation"] == "not reached"
    assert "saturation not reached (largest count" in err


def test_speeds_named_by_folders_are_told_apart(run, bench, tmp_path):
    for number, path in enumerate(sorted((bench / "flats").iterdir())):
        path.rename(path.with_name(f"iso{100 if number % 2 else 400}_{path.name}"))
    code, _, err = call(run, bench, tmp_path / "sensor.yaml")
    assert code == 2
    assert "ISO 100, 400" in err
    code, out, _ = call(run, bench, tmp_path / "sensor.yaml", "--iso", "400", "--json")
    assert (code, json.loads(out)["iso"], json.loads(out)["levels"]["flat"]) == (0, 400, 4)
    code, _, err = call(run, bench, tmp_path / "sensor.yaml", "--iso", "800")
    assert code == 2
    assert "no flat frames of ISO 800" in err


def test_a_single_frame_of_a_level_is_too_few(run, bench, tmp_path):
    path = min((bench / "flats").rglob("*.png"))
    path.unlink()
    code, _, err = call(run, bench, tmp_path / "sensor.yaml")
    assert code == 4
    assert "every level needs at least two frames of the same exposure" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "sensor.yaml").exists()


def test_mixed_exposures_in_a_folder_that_names_one_are_refused(run, bench, tmp_path):
    low, high = (bench / "flats" / name for name in sorted(path.name for path in (bench / "flats").iterdir())[:2])
    for path in high.iterdir():
        path.rename(low / path.name)
    high.rmdir()
    code, _, err = call(run, bench, tmp_path / "sensor.yaml")
    assert code == 4
    assert "mixed" in err


def test_frames_of_another_size_are_refused_with_their_file(run, bench, tmp_path):
    path = min((bench / "flats").rglob("*.png"))
    save(path, np.ascontiguousarray(load(path).pixels[:100]))
    code, _, err = call(run, bench, tmp_path / "sensor.yaml")
    assert code == 2
    assert str(path.parent) in err
    assert "160 × 100" in err


def test_saturated_flats_are_refused(run, scene, tmp_path):
    brightest = max((scene / "flats").iterdir(), key=lambda path: float(path.name[:-2]))
    code, _, err = run(
        "sensor", brightest, "--dark", scene / "darks", "--pattern", "RGGB", "-o", tmp_path / "sensor.yaml"
    )
    assert code == 4
    assert "saturated" in err


def test_a_missing_folder_and_a_missing_pattern_say_so(run, scene, tmp_path):
    assert run("sensor", tmp_path / "none", "--dark", scene / "darks", "-o", tmp_path / "s.yaml")[0] == 3
    code, _, err = run("sensor", scene / "flats", "--dark", scene / "darks", "-o", tmp_path / "s.yaml")
    assert code == 2
    assert "--pattern" in err


def test_an_input_is_never_overwritten(run, bench):
    path = min((bench / "flats").rglob("*.png"))
    before = path.read_bytes()
    for options in (("-o", path), ("-o", bench / "s.yaml", "--plot", path, "--overwrite")):
        code, _, err = run("sensor", bench / "flats", "--dark", bench / "darks", "--pattern", "RGGB", *options)
        assert code == 2
        assert ("is not overwritten" if "--plot" in options else "is not written; use .yaml") in err
    assert path.read_bytes() == before
    assert not (bench / "s.yaml").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--exposure", "1,2,3"], "3 exposures for 1 inputs"),
        (["--exposure", "fast"], "is not seconds, written as 0.01,0.02"),
        (["--exposure", "-1"], "above 0"),
        (["--sensor-format", "1/2.8", "--pitch-um", "3"], "leave out"),
        (["--sensor-format", "fullframe"], "Did you mean 'full frame'"),
        (["--plot", "plot.jpg"], "is not written; use"),
        (["--pitch-um", "nan"], "pixel pitch"),
        (["--white", "0"], "white level"),
    ],
)
def test_options_that_cannot_be_are_refused_in_one_line(run, scene, tmp_path, options, message):
    code, out, err = call(run, scene, tmp_path / "sensor.yaml", *options)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_camera_files_say_their_exposure_speed_and_levels(run, tmp_path):
    raw, rng = RawCamera("GBRG", Sensor(0.5, 3.0, 7000.0, 32.0, 12)), np.random.default_rng(0)
    fixed = FixedPattern.of(raw.sensor, (96, 72), rng)
    for iso in (100, 400):
        shots = [*exposure_series(raw, 5, 0.1), Shot(0.01, 0.0)]
        for number, shot in enumerate(shot for shot in shots for _ in range(2)):
            values = even_frame(raw, shot, 0.1, fixed=fixed, rng=rng)
            taken = Capture(exposure_s=shot.exposure_s, iso=iso)
            frame = Mosaic(values, raw.pattern, np.full((2, 2), 32.0), 4095.0, capture=taken)
            write_dng(tmp_path / ("flat" if shot.share else "dark") / f"{iso}_{number:02d}.dng", frame)
    common = (tmp_path / "flat", "--dark", tmp_path / "dark", "-o", tmp_path / "sensor.yaml", "--json")
    code, out, _ = run("sensor", *common)
    assert (code, "ISO 100, 400" in json.loads(out)["error"]["message"]) == (2, True)
    code, out, _ = run("sensor", *common, "--iso", "400")
    document = json.loads(out)
    assert code == 0
    assert (document["iso"], document["levels"]) == (400, {"flat": 5, "dark": 1})
    assert document["sensor"]["bits"] == 12
    assert document["figures"]["gain_dn_per_e"]["value"] == pytest.approx(0.5, rel=0.05)  # 1 700 samples: 1.3 %


HEADERLESS = Sensor(0.4, 3.0, 20000.0, 32.0, 12)
FRAME = (96, 72)


def dumped(folder, sensor, pixel_format):
    """Write flats and darks of a sensor as header-less files of a pixel format, and return the two folders."""
    raw, rng = RawCamera("RGGB", sensor, (0.5, 1.0, 0.6)), np.random.default_rng(4)
    fixed = FixedPattern.of(sensor, FRAME, rng)
    for shot in [*exposure_series(raw, 6, 0.1), Shot(0.01, 0.0)]:
        place = folder / ("flats" if shot.share else "darks") / f"{1e3 * shot.exposure_s:g}ms"
        place.mkdir(parents=True, exist_ok=True)
        for number in range(2 if shot.share else 4):
            values = even_frame(raw, shot, 0.1, fixed=fixed, rng=rng)
            (place / f"{number}.raw").write_bytes(pack(values, pixel_format_named(pixel_format)))
    return folder / "flats", folder / "darks"


@pytest.mark.parametrize("pixel_format", ["BayerRG12", "BayerRG12p", "pRCC"])
def test_header_less_frames_give_the_counts_of_the_sensor(run, tmp_path, pixel_format):
    flats, darks = dumped(tmp_path, HEADERLESS, pixel_format)
    layout = ("--format", pixel_format, "--size", "96x72")
    code, out, err = run("sensor", flats, "--dark", darks, *layout, "-o", tmp_path / "s.yaml", "--json")
    assert (code, err) == (0, "")
    document = json.loads(out)
    assert document["figures"]["gain_dn_per_e"]["value"] == pytest.approx(0.4, rel=0.05)  # 1 700 samples: 1.3 %
    assert document["figures"]["black_dn"]["value"] == pytest.approx(32, abs=0.2)
    assert (document["sensor"]["bits"], document["levels"]) == (12, {"flat": 6, "dark": 1})


def test_header_less_frames_without_a_layout_are_refused_with_what_fits(run, tmp_path):
    flats, darks = dumped(tmp_path, HEADERLESS, "BayerRG12")
    code, _, err = run("sensor", flats, "--dark", darks, "--size", "96x72", "-o", tmp_path / "s.yaml")
    assert code == 2
    assert "fits Bayer10|Bayer12|Bayer14|Bayer16 96x72" in err
    assert err.endswith("give --format\n")


@pytest.mark.parametrize(("step", "words"), [(16, "scaled by 16:"), (65535 / 4095, "scaled by 16.0037:")])
def test_counts_spread_over_sixteen_bits_are_brought_back(run, tmp_path, step, words):
    flats, darks = dumped(tmp_path, HEADERLESS, "BayerRG12")
    for path in sorted(tmp_path.rglob("*.raw")):
        counts = np.fromfile(path, "<u2").reshape(FRAME[::-1])
        save(path.with_suffix(".png"), np.rint(counts * step).astype(np.uint16))
        path.unlink()
    code, out, err = run("sensor", flats, "--dark", darks, "--pattern", "RGGB", "-o", tmp_path / "s.yaml", "--json")
    document = json.loads(out)
    assert code == 0
    assert document["figures"]["gain_dn_per_e"]["value"] == pytest.approx(0.4, rel=0.05)
    assert document["sensor"]["bits"] == 12
    assert words in err
    assert document["warnings"][0]["values"]["bits"] == 12


def test_ten_bits_declared_as_twelve_are_noticed(run, tmp_path):
    flats, darks = dumped(tmp_path, Sensor(0.4, 3.0, 20000.0, 32.0, 10), "BayerRG12")
    layout = ("--format", "BayerRG12", "--size", "96x72", "-o", tmp_path / "s.yaml")
    code, _, err = run("sensor", flats, "--dark", darks, *layout)
    assert code == 0
    assert "largest count 1023 of 4095: the white level may be 1023 (--white 1023)" in err
    code, _, err = run("sensor", flats, "--dark", darks, *layout, "--white", "1023")
    assert (code, err) == (0, "")


def test_an_optical_format_in_the_place_of_a_pixel_format_is_named(run, scene, tmp_path):
    code, _, err = call(run, scene, tmp_path / "sensor.yaml", "--format", "1/2.8")
    assert code == 2
    assert "the optical one is --sensor-format 1/2.8" in err
    code, _, err = call(run, scene, tmp_path / "sensor.yaml", "--format", "Bayer13")
    assert code == 2
    assert "pixel format 'Bayer13' is unknown" in err


def test_frames_and_outputs_that_are_mixed_up_are_named(run, scene, tmp_path):
    swapped = ("sensor", scene / "darks", "--dark", scene / "flats", "--pattern", "RGGB", "-o", tmp_path / "s.yaml")
    code, _, err = run(*swapped)
    assert code == 4
    assert "the flat frames are darker than the dark ones" in err
    code, _, err = run("sensor", scene / "flats", "--dark", scene / "flats", *swapped[4:])
    assert code == 2
    assert "is both a flat and a dark frame" in err
    code, _, err = call(run, scene, tmp_path)
    assert code == 3
    assert "is a folder, not a file" in err
    code, _, err = call(run, scene, tmp_path / "s.yaml", "--white", "20")
    assert code == 4
    assert "all counts are above the white level of 20" in err
    assert not (tmp_path / "s.yaml").exists()
