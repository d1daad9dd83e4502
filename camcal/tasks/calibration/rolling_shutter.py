"""`camcal calibrate --rolling-shutter`: the readout time by the motion of the board, views as of one moment each."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from camcal.calibrate.intrinsics import Calibration
from camcal.calibrate.timing.calibrate import TimedCamera, time_cameras
from camcal.calibrate.timing.record import TimeCalibration
from camcal.cameras.validity import ImageCircle
from camcal.progress import Progress, stage
from camcal.quality.assess import assess
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.board_views import BoardViews
from camcal.tasks.calibration.model_selection import Selection
from camcal.tasks.poses.frame_times import frame_times
from camcal.tasks.timing import Timing

CAMERA = ""  # the name of the only one
_SAME = 0.1  # standard deviations by which a readout time may change without another solution


def with_frame_times(seen: BoardViews, timing: Timing, progress: Progress) -> BoardViews:
    """Return views with their times; raises InvalidInput where nothing tells them."""
    views = seen.detections.views
    times = frame_times([view.image for view in views], [own.path for own in seen.videos], timing, progress)
    timed = tuple(replace(view, time=time) for view, time in zip(views, times.tolist(), strict=True))
    return replace(seen, detections=replace(seen.detections, views=timed))


def solve_at_once(
    views: Sequence[BoardDetection],
    brief: Callable[[Sequence[BoardDetection]], Calibration | None],
    solve: Callable[[Sequence[BoardDetection]], Selection],
    circle: ImageCircle | None,
    progress: Progress,
) -> Selection:
    """Return the calibration from views as they would be had all rows been taken at once, with the readout time.

    brief, solve: a brief calibration from views as they are, and a whole one. Raises as these and `time_cameras` do.
    """
    start = TimedCamera(brief(views) or solve(views).calibration, views, as_designed=True)
    first = _times(start, progress)
    selection = solve(_at_once(views, first))
    times = _times(TimedCamera(selection.calibration, views), progress)
    own, before = times.cameras[CAMERA], first.cameras[CAMERA]
    if abs((own.readout or 0.0) - (before.readout or 0.0)) > _SAME * own.readout_std:
        selection = solve(_at_once(views, times))
    calibration = selection.calibration
    if calibration.camera.covariance is not None:
        spread = times.spread(tuple(f"{CAMERA}.{name}" for name in calibration.camera.model.parameter_names))
        camera = replace(calibration.camera, covariance=calibration.camera.covariance + spread)
        calibration = replace(calibration, camera=camera)
    return replace(
        selection,
        calibration=calibration,
        assessment=assess(calibration, circle, selection.candidates),
        warnings=(*times.warnings, *selection.warnings),
        times=times,
    )


def _times(camera: TimedCamera, progress: Progress) -> TimeCalibration:
    with stage(progress, "times"):
        return time_cameras({CAMERA: camera}, offsets=False, shutter=True)


def _at_once(views: Sequence[BoardDetection], times: TimeCalibration) -> list[BoardDetection]:
    return times.at(CAMERA, views, [times.timed(CAMERA, view).time for view in views])
