"""Image circles of real fisheyes, around the principal points of their calibrations; none on any other photographs.

What this does not prove: the radius, which no file of these sets states. A lens need not be centred on its circle, but
these are, to about a percent.
"""

from collections import defaultdict

import numpy as np
import pytest

from camcal.images.files import gray_8bit, load
from camcal.images.image_circle import ImageCircleSearch, evenly_spaced
from camcal.images.options import ViewOptions
from camcal.targets.board import parse_board
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.detect import detect_images
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.options import CalibrateOptions, DetectOptions
from camcal.tasks.calibration.undistort import undistort

# principal points px: the first as published with the set, the others calibrated with cv2.fisheye from its images
FISHEYES = {
    "boofcv-theta-chess/*.jpg": (319.18, 319.72),
    "ocamcalib-fish2/*.jpg": (384.49, 239.82),
    "sourishg-fisheye-stereo/imgs/left*.jpg": (471.19, 305.71),
    "sourishg-fisheye-stereo/imgs/right*.jpg": (478.22, 298.20),
}
OTHERS = (
    "aprilgrid", "charuco", "chessboard", "demosaic_gt", "multicam", "other_targets", "pnp", "stereo_gt", "stereo_rig",
)  # fmt: skip
SUFFIXES = (".jpg", ".pgm", ".png", ".tif")
OFF_CENTRE = 0.015  # radii; 0.003 to 0.012 measured


@pytest.mark.parametrize("pattern", FISHEYES)
def test_the_circle_of_a_fisheye_is_centred_on_its_principal_point(pattern, real_data):
    paths = sorted((real_data / "fisheye").glob(pattern))
    if not paths:
        pytest.skip(f"no fisheye/{pattern}")
    search = ImageCircleSearch()
    for index in evenly_spaced(len(paths)):
        search.add(gray_8bit(load(paths[index]).pixels))
    circle = search.result()
    assert circle is not None
    assert np.hypot(*np.subtract(circle.centre, FISHEYES[pattern])) < OFF_CENTRE * circle.radius
    assert circle.supported > 0.85
    assert circle.dark_corners == 4


@pytest.mark.parametrize("category", OTHERS)
def test_photographs_of_other_lenses_have_no_circle_neither_together_nor_alone(category, real_data):
    """Together are those of one folder and size, also of several cameras; alone is every fifth."""
    searches = defaultdict(ImageCircleSearch)
    paths = sorted(path for path in (real_data / category).rglob("*") if path.suffix in SUFFIXES)
    for index, path in enumerate(paths):
        image = gray_8bit(load(path).pixels)
        searches[path.parent, image.shape].add(image)
        if index % 5:
            continue
        alone = ImageCircleSearch()
        alone.add(image)
        assert alone.result() is None, path
    for (folder, _), search in searches.items():
        assert search.result() is None, folder
    if not searches:
        pytest.skip(f"no photographs in {category}")


def test_a_calibration_from_the_table_of_a_fisheye_knows_its_circle_and_its_views_end_there(real_data, tmp_path):
    images = sorted((real_data / "fisheye" / "boofcv-theta-chess").glob("*.jpg"))
    if not images:
        pytest.skip("no fisheye/boofcv-theta-chess")
    table = tmp_path / "corners.csv"
    options = DetectOptions(images, parse_board("chessboard:6x4:30mm"), table, jobs=1)
    circle = detect_images(options).detections.circles[""]
    report = calibrate(CalibrateOptions((str(table),), tmp_path / "camera.yaml", model="kannala_brandt4"))
    assert report.file.cameras["camera"].image_circle == circle
    assert report.assessment.trustworthy
    view = ViewOptions(projection="stereographic", fov_deg=250.0)
    drawn = undistort(
        UndistortOptions(
            str(tmp_path / "camera.yaml"), tmp_path / "view", (str(images[0]),), view=view, mask=True, format="png"
        )
    )
    disc = 2 * drawn.view.value("fx") * np.tan(np.radians(108) / 2)  # the model ends before the circle, at 107 to 109°
    assert drawn.valid == pytest.approx(np.pi * disc**2 / np.prod(drawn.view.image_size), rel=0.05)
    mask, shown = (
        gray_8bit(load(tmp_path / "view" / "valid_mask.png").pixels),
        gray_8bit(load(drawn.outcomes[0].value.output).pixels),
    )
    assert mask.mean() / 255 == pytest.approx(drawn.valid)
    assert (shown[mask == 0] == 0).all()
