"""lensfun's databases against its formulas, written here from its documentation, and against lensfunpy where it is.

lensfun computes in single precision, and its vector code for ptlens mixed neighbouring pixels up to 0.3.4: rows whose
memory is not aligned go through the plain code, and are compared.
"""

import re

import numpy as np
import pytest

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats import cameras
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras import FORMATS
from camcal.formats.cameras.record import Given, MissingSize

SIZE = (601, 401)  # of 3:2 between the centres of its outer pixels: r = 1 is 200 px
HALF_MM = np.hypot(36, 24) / 2 / 1.5 / np.hypot(1.5, 1)  # half the shorter side of a sensor of crop factor 1.5

DATABASE = """<!DOCTYPE lensdatabase SYSTEM "lensfun-database.dtd">
<lensdatabase version="1">
  <camera><maker>M</maker><model>Body</model><mount>Generic</mount><cropfactor>1.5</cropfactor></camera>
  <lens><maker>Maker</maker><model>Maker Zoom 20-40mm f/2.8</model><model lang="de">andere</model><mount>Generic</mount>
    <cropfactor>1.5</cropfactor>
    <calibration>
      <distortion model="ptlens" focal="20" a="0.02" b="-0.05" c="0.01"/>
      <distortion model="poly3" focal="22" k1="0.5"/>
      <distortion model="ptlens" focal="24" a="0.01" b="-0.03" c="0.012"/>
      <distortion model="ptlens" focal="40" a="0" b="0.004" c="0"/>
      <tca model="poly3" focal="20" vr="1.0005" vb="0.9996" br="0.0002" cb="-0.0001"/>
      <tca model="poly3" focal="40" vr="1.0001" vb="0.9999"/>
      <vignetting model="pa" focal="20" aperture="2.8" distance="10" k1="-0.5" k2="0" k3="0"/>
    </calibration></lens>
  <lens><maker>Maker</maker><model>Prime 30mm T* 1.4</model><mount>Generic</mount><cropfactor>1.5</cropfactor>
    <aspect-ratio>4:3</aspect-ratio><center x="0.02" y="-0.01"/>
    <calibration><distortion model="poly3" focal="30" k1="-0.02"/><tca model="linear" focal="30" kr="1.0003"/>
    </calibration></lens>
  <lens><maker>Maker</maker><model>Round 8mm</model><mount>Generic</mount><type>equisolid</type>
    <cropfactor>1.5</cropfactor><calibration><distortion model="ptlens" focal="8" a="0.01" b="-0.03" c="0.02"/>
    <real-focal-length focal="8" real-focal="8.2"/></calibration></lens>
  <lens><maker>Maker</maker><model>Flat 12mm</model><mount>Generic</mount><type>panoramic</type>
    <cropfactor>1.5</cropfactor><calibration><distortion model="poly5" focal="12" k1="0.01" k2="0.02"/></calibration>
  </lens>
  <lens><maker>Maker</maker><model>Unknown 9mm</model><mount>Generic</mount><cropfactor>1.5</cropfactor></lens>
</lensdatabase>
"""


@pytest.fixture
def database(tmp_path):
    path = tmp_path / "lenses.xml"
    path.write_text(DATABASE)
    return path


def read(path, size=SIZE):
    return cameras.read(path, given=Given(size))


def radii(camera, ideal_px, radius):
    """Return how far from the middle, in r, a camera shows what a pinhole (focal length in px) shows at radii (N,)."""
    points = np.column_stack([radius * 200 / ideal_px, np.zeros_like(radius), np.ones_like(radius)])
    return (camera.project(points).pixels[:, 0] - (SIZE[0] - 1) / 2) / 200


RADIUS = np.linspace(0.05, 1.75, 30)


def test_ptlens_is_a_polynomial_of_the_radius_that_leaves_the_middle_of_the_longer_side(database):
    camera = read(database).cameras["Maker_Zoom_20_40mm_f_2_8_20mm"].camera
    expected = 0.02 * RADIUS**4 - 0.05 * RADIUS**3 + 0.01 * RADIUS**2 + 1.02 * RADIUS
    assert camera.model.name == "ptlens"
    np.testing.assert_allclose(radii(camera, 20 / HALF_MM * 200, RADIUS), expected, atol=1e-12)


def test_colours_are_polynomials_of_the_radius_of_green(database):
    entry = read(database).cameras["Maker_Zoom_20_40mm_f_2_8_20mm"]
    ideal = 20 / HALF_MM * 200
    green = radii(entry.camera, ideal, RADIUS)
    red, blue = (radii(entry.channels[colour], ideal, RADIUS) for colour in ("red", "blue"))
    np.testing.assert_allclose(red, 0.0002 * green**3 + 1.0005 * green, atol=2e-5)  # 0.004 px
    np.testing.assert_allclose(blue, -0.0001 * green**2 + 0.9996 * green, atol=2e-5)


def test_a_colour_that_is_larger_or_smaller_only_is_exact(database):
    entry = read(database).cameras["Maker_Prime_30mm_t_1_4_30mm"]
    np.testing.assert_allclose(entry.channels["red"].parameters[4:], entry.camera.parameters[4:], rtol=1e-14)
    np.testing.assert_allclose(entry.channels["red"].value("fx") / entry.camera.value("fx"), 1.0003, rtol=1e-14)
    np.testing.assert_allclose(entry.channels["blue"].parameters, entry.camera.parameters, rtol=1e-14)


def test_the_middle_and_the_sides_of_the_calibration_count(database):
    camera = read(database).cameras["Maker_Prime_30mm_t_1_4_30mm"].camera
    half = np.hypot(600, 400) / 2 / np.hypot(4 / 3, 1)  # px of r = 1, the shorter side of 4:3 of the same diagonal
    half_mm = np.hypot(36, 24) / 2 / 1.5 / np.hypot(4 / 3, 1)
    assert camera.model.name == "opencv4"
    np.testing.assert_allclose(camera.parameters[2:4], [300 + 0.02 * 200, 200 - 0.01 * 200])
    np.testing.assert_allclose(camera.value("fx"), 30 / half_mm * half * 1.02)
    np.testing.assert_allclose(camera.value("k1"), -0.02 / 1.02 * (30 / half_mm) ** 2)


def test_the_real_focal_length_is_that_of_the_middle(database):
    camera = read(database).cameras["Maker_Round_8mm_8mm"].camera
    np.testing.assert_allclose(camera.focal_lengths()[0], 8.2 / HALF_MM * 200)
    theta = np.radians(np.arange(1, 60))
    ideal = 8.2 / HALF_MM * 2 * np.sin(theta / 2)  # in r, of the plane before the distortion: 1 - a - b - c is 1
    points = np.column_stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)])
    found = (camera.project(points).pixels[:, 0] - 300) / 200
    np.testing.assert_allclose(found, 0.01 * ideal**4 - 0.03 * ideal**3 + 0.02 * ideal**2 + ideal, atol=1e-12)


def test_terms_times_focal_lengths_are_interpolated_with_mean_slopes(database):
    lens = read(database).cameras["Zoom 20-40mm@30"]
    # at 24 and 40 mm, of which the first has a neighbour at 20: t = 3/8
    b = np.array([-0.05 * 20, -0.03 * 24, 0.004 * 40])
    t = 3 / 8
    expected = (2 * t**3 - 3 * t**2 + 1) * b[1] + (t**3 - 2 * t**2 + t) * (b[2] - b[0]) / 2
    expected += (3 * t**2 - 2 * t**3) * b[2] + (t**3 - t**2) * (b[2] - b[1])
    camera, scale = lens.camera, (30 / HALF_MM) ** 2
    middle = camera.value("fx") / (30 / HALF_MM * 200)
    np.testing.assert_allclose(camera.value("a3") * middle / scale, expected / 30)


def test_a_sensor_of_another_crop_factor_shows_another_part(database):
    file = read(database)
    own, smaller = file.cameras["zoom 20-40@20"].camera, file.cameras["zoom 20-40@20,3"].camera
    np.testing.assert_allclose(smaller.parameters[:2], 2 * own.parameters[:2])
    np.testing.assert_allclose(smaller.parameters[4:], own.parameters[4:])


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("Nothing@20", "no lens with distortion is 'Nothing'.*Maker Zoom 20-40mm f/2.8, Maker Prime"),
        ("Maker@20", "4 lenses are 'Maker'"),
        ("Zoom", "calibrated at 20 to 40 mm: give Zoom@FOCAL"),
        ("Zoom@60", "calibrated at 20 to 40 mm"),
        ("Flat", "'panoramic' is not a lens of this program"),
    ],
)
def test_what_is_not_one_lens_is_refused_in_one_line(database, address, said):
    with pytest.raises(InvalidInput, match=said) as raised:
        cameras.select(read(database), address, str(database))
    assert "\n" not in str(raised.value)


def test_a_database_without_the_size_of_images_says_what_it_holds(database):
    with pytest.raises(MissingSize, match=r"4 lenses .*Maker Zoom 20-40mm f/2.8.*FILE#LENS@FOCAL and --size WxH"):
        cameras.read(database)
    database.write_text("<lensdatabase><camera/></lensdatabase>")
    with pytest.raises(InvalidInput, match=r"holds no lens with distortion.*read as lensfun"):
        cameras.read(database)


def test_what_is_wrong_in_a_database_is_said_with_its_key(database):
    database.write_text(DATABASE.replace('model="poly3" focal="30"', 'model="acm" focal="30"'))
    with pytest.raises(InvalidInput, match="'acm' is none of lensfun's; read are poly3, poly5, ptlens"):
        read(database)
    database.write_text(DATABASE.replace('b="-0.05"', 'b="much"'))
    with pytest.raises(InvalidInput, match=r"<distortion>.*@b: 'much' is not a finite number"):
        read(database)
    database.write_text(DATABASE.replace("<aspect-ratio>4:3", "<aspect-ratio>4:0"))
    with pytest.raises(InvalidInput, match="aspect-ratio: 4:0 is not positive"):
        read(database)
    database.write_text(DATABASE.replace('SYSTEM "lensfun-database.dtd"', "[<!ENTITY a 'b'>]"))
    with pytest.raises(cameras.CamcalError, match="document type"):
        read(database)


def test_a_lens_with_tangential_terms_or_two_focal_lengths_is_not_written_exactly(tmp_path):
    for parameters in ([500, 501, 300, 200, -0.1, 0.02, 0, 0], [500, 500, 300, 200, -0.1, 0.02, 1e-3, 0]):
        file = CameraFile({"camera": CameraEntry(Camera(MODELS["opencv4"], SIZE, parameters))})
        with pytest.raises(InvalidInput, match="lensfun lens database has no"):
            cameras.write(tmp_path / "lensfun.xml", file, FORMATS["lensfun"])


def test_a_known_size_of_pixels_gives_focal_lengths_in_mm(tmp_path):
    camera = Camera(MODELS["opencv4"], SIZE, [500, 500, 303, 198, -0.1, 0.02, 0, 0])
    file = CameraFile({"camera": CameraEntry(camera, sensor={"pixel_pitch_um": 10.0})})
    cameras.write(tmp_path / "lensfun.xml", file, FORMATS["lensfun"])
    text = (tmp_path / "lensfun.xml").read_text()
    np.testing.assert_allclose(float(re.search(r'focal="([\d.]+)"', text)[1]), 5.0, rtol=1e-12)
    (entry,) = read(tmp_path / "lensfun.xml").cameras.values()
    np.testing.assert_allclose(entry.camera.parameters, camera.parameters, rtol=1e-12)


@pytest.mark.parametrize("size", [(25, 17), (25, 21)])
def test_lensfun_itself_moves_pixels_alike(database, size):
    lensfunpy = pytest.importorskip("lensfunpy")
    own = lensfunpy.Database(paths=[str(database)], load_common=False, load_bundled=False)
    file, lenses = read(database, size), {lens.model.split()[-2]: lens for lens in own.lenses}
    for name, focal in (("20-40mm", 20.0), ("20-40mm", 33.0), ("T*", 30.0), ("Round", 8.0)):
        lens = lenses[name]
        modifier = lensfunpy.Modifier(lens, lens.crop_factor, *size)
        flags = lensfunpy.ModifyFlags.DISTORTION | lensfunpy.ModifyFlags.GEOMETRY
        modifier.initialize(focal, 8.0, 1000.0, scale=1.0, targeom=lensfunpy.LensType.RECTILINEAR, flags=flags)
        pixels = modifier.apply_geometry_distortion()[1::2].reshape(-1, 2)
        entry = file.cameras[f"{lens.model}@{focal}"]
        x, y = np.meshgrid(np.arange(size[0]), np.arange(1, size[1], 2))
        half_mm = np.hypot(36, 24) / 2 / lens.crop_factor
        length = (8.2 if name == "Round" else focal) / half_mm * np.hypot(size[0] - 1, size[1] - 1) / 2
        centre = entry.camera.parameters[2:4]
        plane = (np.column_stack([x.ravel(), y.ravel()]) - centre) / length
        found = entry.camera.project(np.column_stack([plane, np.ones(len(plane))]))
        assert np.abs(found.pixels - pixels)[found.valid].max() < 1e-5  # single precision
