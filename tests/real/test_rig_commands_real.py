"""`camcal rig` on real images: one folder with both cameras, folders of three, and what is said of them."""

import numpy as np

from camcal.formats import native
from camcal.tasks.rigs.calibrate_rig import rig
from camcal.tasks.rigs.inspect_rig import inspect_rig
from camcal.tasks.rigs.options import RigSettings, RigTaskOptions


def test_a_pair_in_one_folder(real_data, tmp_path):
    settings = RigSettings(tmp_path / "rig.yaml", "chessboard:6x4:30mm", refine=False)
    report = rig(RigTaskOptions((str(real_data / "stereo_rig/boofcv-bumblebee2-chess"),), settings))
    assert report.views.matched.line == "11 captures of 2 cameras, matched by name"
    assert report.trustworthy
    models = {own.camera.model.name for own in report.calibration.calibrations.values()}
    assert len(models) == 1  # both lenses are of a kind
    file = native.read(tmp_path / "rig.yaml")
    found = inspect_rig(file, "rig.yaml")
    pair = found.pairs[0]
    assert abs(pair.baseline.value - 0.12) < 0.001  # as the maker says
    assert 0 < pair.baseline.std < 2e-4
    assert len(found.boards) == 22
    assert pair.epipolar_px < 0.5


def test_three_cameras_in_folders_of_one_folder(real_data, tmp_path):
    for side in ("left", "middle", "right"):
        (tmp_path / "images" / side).mkdir(parents=True)
        for path in sorted((real_data / "multicam/boofcv-trinocular" / side).glob("*.jpg"))[::2]:
            (tmp_path / "images" / side / path.name).symlink_to(path)
    settings = RigSettings(tmp_path / "rig.yaml", "chessboard:13x9:30mm", refine=False)
    report = rig(RigTaskOptions((str(tmp_path / "images"),), settings))
    assert list(report.calibration.poses) == ["left", "middle", "right"]
    assert len(report.views.captures) == 15
    assert not report.views.matched.unmatched
    places = [-pose.rotation.T @ pose.translation for pose in report.calibration.poses.values()]
    assert np.linalg.norm(places[2]) > np.linalg.norm(places[1]) > 0.1
    joint = report.file.joint_covariance
    assert len(joint.names) == 3 * 9 + 2 * 6
