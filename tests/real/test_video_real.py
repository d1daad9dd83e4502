"""A real video: frames are chosen that are sharp and differ, and the lens comes out as others published it."""

import numpy as np

from camcal.calibrate.frames import MOVING
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.options import CalibrateOptions, FrameOptions


def test_a_video_of_a_moving_camera_gives_the_published_lens(real_data, tmp_path):
    video = real_data / "pnp" / "boofcv-chessboard-video" / "movie.mjpeg"
    frames = FrameOptions(20, every=2)
    options = CalibrateOptions(
        (str(video),),
        tmp_path / "camera.yaml",
        "chessboard:6x4:30mm",
        "opencv4",
        flat_board=True,
        jobs=1,
        frames=frames,
    )
    report = calibrate(options)
    camera = report.calibration.camera
    assert sum(record.taken for record in report.frames) == 20
    # the board is moved quickly in the beginning and hardly at all later; 19 to 33 were recorded on the way
    quick = [int(record.view.image[-6:]) for record in report.frames if record.choice and record.choice.why == MOVING]
    assert set(range(20, 25, 2)) <= set(quick)
    assert max(quick) < 125
    focal = np.array([camera.value("fx"), camera.value("fy")])
    np.testing.assert_allclose(focal, [529.03, 528.80], rtol=0.006)  # from stills of the same camera
    assert report.calibration.rms_px < 0.12
