"""Camera files are known by their content, and every family is refused in its own words or read."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from camcal.errors import CamcalError, InvalidInput
from camcal.formats import cameras
from camcal.formats.cameras import FORMATS
from camcal.formats.cameras.record import ROWS, named, recognise

DATA = Path(os.environ.get("CAMCAL_TEST_DATA", Path(__file__).parents[3] / "shared/data"))
EXAMPLES = DATA.parent / "reference" / "format_examples"
# A line or two of each family, as its program writes them.
WRITTEN = {
    "camcal": "format: camcal-calibration\nversion: 1\n",
    "USD": '#usda 1.0\ndef Camera "Camera" ()\n',
    "Blender": "BLENDER-v300\n",
    "Pix4D": "Pix4D camera calibration file 0\nF 15.0\n",
    "Bundler": "# Bundle file v0.3\n1 10\n",
    "VisualSFM": "NVM_V3\n\n1\n",
    "COLMAP images": "# Image list with two lines of data per image:\n",
    "HALCON": "ParGroup: Cameras: Internal Parameters;\n",
    "ZED": "[LEFT_CAM_HD]\nfx=701.88\n",
    "CAHVOR": "Dimensions = 6016 4016\nModel = CAHV = perspective, linear\n",
    "ocamcalib": "#polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB).\n",
    "DSO": "RadTan 458.6 457.3 367.2 248.4 -0.28 0.07 0.0002 1e-05\n752 480\n",
    "RealityCapture": '<x:xmpmeta><rdf:Description xcr:Version="3"/></x:xmpmeta>\n',
    "Adobe": '<rdf:li stCamera:Make="Canon"/>\n',
    "URDF": '<?xml version="1.0"?>\n<robot name="arm">\n</robot>\n',
    "OpenMVG": '{"sfm_data_version": "0.3", "intrinsics": []}',
    "AliceVision": '{"version": ["1"], "intrinsics": [{"intrinsicId": "1"}]}',
    "Azure Kinect": '{"CalibrationInformation": {"Cameras": []}}',
    "Aria": '{"CameraCalibrations": []}',
    "advanced-mode": '{"intrinsic_left.x.x": 0.5}',
    "BOP scene": '{"0": {"cam_K": [1, 0, 0, 0, 1, 0, 0, 0, 1]}}',
    "BOP camera": '{"cx": 325.0, "depth_scale": 0.1, "fx": 572.0}',
    "NumPy": "\x93NUMPY\x01\x00",
}


@pytest.mark.parametrize("name", WRITTEN)
def test_a_family_is_told_by_its_content(tmp_path, name):
    path = tmp_path / "file.yaml"
    path.write_bytes(WRITTEN[name].encode("latin-1"))
    row = recognise(cameras.source_of(path).text)
    assert name in (row.name, *row.title.split(), row.title) or row.title.startswith(name.split()[0])
    if row.instead:
        with pytest.raises(InvalidInput, match=re.escape(f"{path}: {row.title}: not read; {row.instead}")):
            cameras.read(path)
        assert cameras.is_camera_file(path)


def test_every_row_is_read_or_says_what_to_do():
    for row in ROWS:
        assert bool(row.title) == bool(row.instead), row
        assert row.name or row.instead, row
        assert "YAML" not in row.title + row.instead
    assert next(iter(FORMATS)) == "camcal"
    assert [FORMATS[name].name for name in FORMATS] == list(FORMATS)


@pytest.mark.skipif(not EXAMPLES.is_dir(), reason="the examples of the reference are not here")
def test_every_example_is_read_or_refused_in_the_words_of_its_family():
    for path in sorted(EXAMPLES.iterdir()):
        if path.suffix == ".md":
            continue
        row = recognise(cameras.source_of(path).text)
        assert row is not None, path
        said = refusal(path)
        if said is not None:
            assert (row.title or FORMATS[row.name].title) in said
            assert "YAML" not in said
            assert re.search(r"\b(give|export|calibrate|import|undistort|convert|optimi[sz]e)\b", said), said


def refusal(path):
    """Return what a file is refused with, None if it is read."""
    try:
        assert cameras.read(path).cameras
    except CamcalError as error:
        return str(error).replace(str(path), "")
    return None


def test_names_of_other_programs_get_no_other_file(tmp_path):
    own = FORMATS["camcal"]
    for name in ("transforms.json", "cameras.txt", "left.cameramodel", "array.toml", "metashape.xml", "a.mat", "x.cam"):
        row = named(name)
        assert row is not None
        if row.instead:
            with pytest.raises(InvalidInput, match=re.escape(f"is a name of {row.title}, which is not written")):
                cameras.format_for(tmp_path / name, None, own)
        else:
            assert cameras.format_for(tmp_path / name, None, own).name == row.name
    assert cameras.format_for(tmp_path / "camera.xml", None, own).name == "opencv"
    assert cameras.format_for(tmp_path / "transforms.json", "opencv", own).name == "opencv"


@pytest.mark.parametrize(("text", "said"), [("<svg></svg>", "is XML with the root <svg>"), ("< >", "without a root")])
def test_xml_of_no_family_is_said_to_be_of_none(tmp_path, text, said):
    path = tmp_path / "a.xml"
    path.write_text(text)
    with pytest.raises(CamcalError, match=said) as caught:
        cameras.read(path)
    assert "YAML" not in str(caught.value)


def test_a_family_is_loaded_only_where_a_file_is_of_it(tmp_path):
    text = "K: [[500, 0, 320], [0, 500, 240], [0, 0, 1]]\nD: [0, 0, 0, 0, 0]\nsize: [640, 480]\n"
    (tmp_path / "a.yml").write_text(text)
    script = (
        "import sys; from camcal.formats import cameras; cameras.read('a.yml'); "
        "print(*sorted(each for each in sys.modules if each.startswith('camcal.formats.cameras.'))); "
        "print(*sorted({'cv2', 'scipy', 'pydantic', 'tomllib', 'xml.sax'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    loaded, others = done.stdout.split("\n")[:2]
    families = {each.rpartition(".")[2] for each in loaded.split()} & set(FORMATS.modules.values())
    assert families == {"opencv"}
    assert others == ""


@pytest.mark.parametrize("filling", ["\n", " ", "<sensor ", "a = [", "[a]\n", '"x": ', "1 ", "- ", "cam0:\n"])
def test_no_text_is_searched_for_long(tmp_path, filling):
    path = tmp_path / "a.txt"
    path.write_text(filling * ((1 << 20) // len(filling)))
    started = time.process_time()
    row = recognise(cameras.source_of(path).text)
    if row is None or row.name not in ("kalibr", "ros", "opencv"):
        assert refusal(path) is not None
    assert time.process_time() - started < 20.0  # quadratic searches take minutes
