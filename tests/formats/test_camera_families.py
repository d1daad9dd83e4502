"""Contract of the families of camera files, run over their declarations: what is written is read back the same."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.errors import CamcalError
from camcal.formats import cameras
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras import FORMATS
from camcal.formats.cameras.record import Given
from camcal.geometry.pose import Pose

DATA = Path(os.environ.get("CAMCAL_TEST_DATA", Path(__file__).parents[3] / "shared/data"))
GOLDEN = DATA.parent / "reference" / "golden_vectors.json"
SIZE = (752, 480)
DECLARED = [form for form in FORMATS.values() if form.lenses is not None]
DECLARED = [form for form in DECLARED if form.suffixes]  # those that are written
WRITTEN = [(form.name, row) for form in DECLARED for row in form.lenses.rows if row.model in MODELS]
RIGHT_T_LEFT = Pose.from_vector(np.array([0.011, -0.023, 0.0071]), np.array([-0.1103, 0.00045792, -0.00064487]))
FISHEYE = "kannala_brandt4"


def lens(row, seed=0):
    """Return a camera of a declared lens: its parameters are as in some lens, all others are zero."""
    rng = np.random.default_rng(seed)
    names = {own.name for own in row.keys}
    values = {"fx": 458.654, "fy": 458.654 if "f" in names else 457.296, "cx": 367.215, "cy": 248.375}
    if "cx" not in names:
        values |= {"cx": (SIZE[0] - 1) / 2, "cy": (SIZE[1] - 1) / 2}
    model = MODELS[row.model]
    drawn = model.prior_mean + 0.01 * np.abs(rng.normal(size=len(model.parameter_names)))
    coefficients = dict(zip(model.parameter_names, drawn, strict=True))
    values |= {name: coefficients[name] for name in names & set(model.parameter_names[4:])}
    return Camera(model, SIZE, np.array([values.get(name, 0.0) for name in model.parameter_names]))


def points(seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-0.8, 0.8, (1000, 2)), rng.uniform(0.9, 3.0, 1000)])


def assert_same_pixels(found, expected, tolerance=1e-9):
    assert found.image_size == expected.image_size
    here, there = found.project(points()), expected.project(points())
    assert np.array_equal(here.valid, there.valid)
    assert there.valid.sum() > 500
    assert np.abs(here.pixels - there.pixels)[there.valid].max() < tolerance


def written(folder, file, form):
    """Write a file in a format, and return the paths."""
    path = folder / "file" if form.in_folder else folder / f"file{form.suffixes[0]}"
    cameras.write(path, file, form)
    return form.outputs(path, file)


@pytest.mark.parametrize(("name", "row"), WRITTEN, ids=[f"{name}-{row.word}-{row.model}" for name, row in WRITTEN])
def test_a_lens_is_read_as_it_was_written(tmp_path, name, row):
    form, expected = FORMATS[name], lens(row)
    for suffix in form.suffixes:
        path = tmp_path / f"file{suffix}"
        cameras.write(path, CameraFile({"camera": CameraEntry(expected)}), form)
        assert cameras.format_of(path) is form
        (entry,) = cameras.read(path, given=Given(SIZE)).cameras.values()
        assert_same_pixels(entry.camera, expected)
        assert form.lenses.row(entry.camera) == form.lenses.row(expected)
        first = path.read_bytes()
        cameras.write(path, CameraFile({"camera": CameraEntry(expected)}), form)
        assert path.read_bytes() == first


@pytest.mark.parametrize("form", [form for form in FORMATS.values() if form.lenses], ids=lambda form: form.name)
def test_a_declared_lens_has_parameters_of_its_model_only(form):
    for row in form.lenses.rows:
        if row.model in MODELS and row.model != "splined_stereographic":  # whose file has its knots in rows
            assert {own.name for own in row.keys} <= {*MODELS[row.model].parameter_names, "f", "fx-fy", "0"}, row


@pytest.mark.skipif(not GOLDEN.is_file(), reason="the golden vectors of the reference are not here")
def test_golden_vectors_pass_through_every_family_that_has_the_lens(tmp_path):
    tried = 0
    for vector in json.loads(GOLDEN.read_text())["vectors"]:
        model = MODELS.get(vector["model"])
        if model is None or set(model.parameter_names) - set(vector["params"]):
            continue
        camera = Camera(model, (1280, 960), np.array([vector["params"][name] for name in model.parameter_names]))
        for form in DECLARED:
            if form.lenses.row(camera) is None:
                continue
            path = tmp_path / f"{form.name}-{model.name}{form.suffixes[0]}"
            cameras.write(path, CameraFile({"camera": CameraEntry(camera)}), form)
            (entry,) = cameras.read(path, given=Given((1280, 960))).cameras.values()
            apart = entry.camera.project(np.array(vector["points_cam"])).pixels - np.array(vector["pixels"])
            assert np.nanmax(np.abs(apart)) < 1e-9, path
            tried += 1
    assert tried > len(DECLARED)


@pytest.mark.parametrize("form", DECLARED, ids=[form.name for form in DECLARED])
def test_the_middle_of_the_image_is_where_the_family_counts_it(form):
    camera = Camera(MODELS["pinhole"], SIZE, [400.0, 400.0, (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2])
    row = form.lenses.row(camera)
    if row is None or not {"cx", "cy"} <= {own.name for own in row.keys}:
        return
    _, numbers = form.lenses.written(camera)
    keys = {own.name: own.key for own in row.keys}
    expected = 0.0 if form.lenses.centred else (SIZE[0] - 1) / 2 + form.lenses.origin
    assert numbers[keys["cx"]] == expected


@pytest.mark.parametrize("form", DECLARED, ids=[form.name for form in DECLARED])
def test_a_truncated_file_is_refused_in_one_line_or_read(tmp_path, form):
    row = next(row for row in form.lenses.rows if row.model in MODELS)
    path = tmp_path / f"file{form.suffixes[0]}"
    cameras.write(path, CameraFile({"camera": CameraEntry(lens(row))}), form)
    content = path.read_bytes()
    for share in (0.3, 0.5, 0.7, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        said = refusal(path)
        assert "\n" not in said
        if cameras.recognise(cameras.source_of(path).text) is not None:
            assert "YAML" not in said


def refusal(path):
    """Return what a file is refused with, nothing if it is read."""
    try:
        cameras.read(path, given=Given(SIZE))
    except CamcalError as error:
        return str(error).replace(str(path), "")
    return ""


def pair_of(model):
    """Return two cameras of a lens model with one focal length each, and where the second stands."""
    entries = {}
    for seed, side in enumerate(("left", "right")):
        values = {"fx": 458.654 + seed, "fy": 458.654 + seed, "cx": 367.2 - seed, "cy": 248.4}
        count = len(MODELS[model].parameter_names) - 4
        parameters = [*values.values(), *(0.01 * np.random.default_rng(seed).normal(size=count))]
        entries[side] = CameraEntry(Camera(MODELS[model], SIZE, np.array(parameters)))
    return CameraFile(entries, {"right_T_left": Transform(RIGHT_T_LEFT)})


POSED = [form for form in DECLARED if form.most_cameras != 1 and form.poses not in ("", "not read")]


@pytest.mark.parametrize("form", POSED, ids=[form.name for form in POSED])
def test_a_pair_comes_back_with_the_place_of_the_second(tmp_path, form):
    lenses = (FISHEYE, "opencv4", "opencv5", "pinhole")[form.name == "boofcv" :]  # whose pairs are of no fisheyes
    file = pair_of(next(model for model in lenses if model in form.models))
    paths = written(tmp_path, file, form)
    back = cameras.read(paths[0], given=Given(SIZE), second=paths[1] if len(paths) > 1 else None)
    first, second = back.cameras
    pose = pose_between(back, second, first)
    assert np.abs(pose.matrix() - RIGHT_T_LEFT.matrix()).max() < 1e-12
    for found, expected in zip(back.cameras.values(), file.cameras.values(), strict=True):
        assert_same_pixels(found.camera, expected.camera)


@pytest.mark.parametrize("form", DECLARED, ids=[form.name for form in DECLARED])
def test_a_lens_that_a_family_does_not_have_is_refused(tmp_path, form):
    camera = Camera(MODELS["cylinder"], SIZE, [400.0, 400.0, 375.5, 239.5])
    with pytest.raises(CamcalError, match=re.escape(form.title)) as caught:
        cameras.write(tmp_path / f"a{form.suffixes[0]}", CameraFile({"camera": CameraEntry(camera)}), form)
    assert "\n" not in str(caught.value)


def test_a_spline_goes_to_mrcal_and_back_with_all_its_knots(tmp_path):
    model = MODELS["splined_stereographic"].configured({"knots": [11, 9], "fov_x_deg": 130, "degree": 2})
    parameters = model.start(SIZE, 400.0)
    parameters[4:] = np.random.default_rng(1).normal(0, 0.01, len(parameters) - 4)
    camera = Camera(model, SIZE, parameters)
    path = tmp_path / "a.cameramodel"
    cameras.write(path, CameraFile({"camera": CameraEntry(camera)}), FORMATS["mrcal"])
    word = "LENSMODEL_SPLINED_STEREOGRAPHIC_order=2_Nx=11_Ny=9_fov_x_deg=130"
    assert f"'lensmodel':  '{word}'" in path.read_text(encoding="utf-8")
    found = cameras.read_camera(path)
    assert found.model == model
    np.testing.assert_array_equal(found.parameters, parameters)


def test_a_spline_that_mrcal_cannot_have_or_name_is_refused_in_one_line(tmp_path):
    model = MODELS["splined_stereographic"].configured({"fov_x_deg": 130.5})
    entry, path = CameraEntry(Camera(model, SIZE, model.start(SIZE, 400.0))), tmp_path / "a.cameramodel"
    with pytest.raises(CamcalError, match=r"a whole number of degrees as fov_x_deg, not 130\.5"):
        cameras.write(path, CameraFile({"camera": entry}), FORMATS["mrcal"])
    numbers = ", ".join(["500.0"] * 4 + ["0.0"] * 32)
    head = "{'lensmodel': 'LENSMODEL_SPLINED_STEREOGRAPHIC_order=3"
    tail = f"', 'intrinsics': [{numbers}], 'extrinsics': [0, 0, 0, 0, 0, 0], 'imagersize': [752, 480]}}"
    for knots, words in {
        "_Nx=4_Ny=4_fov_x_deg=100": None,
        "_Nx=4_Ny=5_fov_x_deg=100": "36 numbers",
        "_Nx=4_Ny=3_fov_x_deg=100": r"knots \[4, 3\]: write \[columns, rows\] from 4",
        "_Nx=4": "a spline is named …_order=3_Nx=30_Ny=18_fov_x_deg=150",
    }.items():
        path.write_text(head + knots + tail, encoding="utf-8")
        if words is None:
            assert cameras.read_camera(path).model.knots == (4, 4)
        else:
            with pytest.raises(CamcalError, match=words):
                cameras.read(path)
