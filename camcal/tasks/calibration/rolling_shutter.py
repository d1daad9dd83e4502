"""`camcal calibrate --rolling-shutter`: the readout time by the motion of the board, and views as of one moment each."""

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
from camcal.tasks.poses.smooth_options import Timing

CAMERA = ""  # the name of the only one


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
    lens = brief(views) or solve(views).calibration
    selection = solve(_at_once(views, _timed(lens, views, progress)))
    times = _timed(selection.calibration, views, progress)
    selection = solve(_at_once(views, times))
    own = selection.calibration
    if own.camera.covariance is not None:
        spread = times.spread(tuple(f"{CAMERA}.{name}" for name in own.camera.model.parameter_names))
        own = replace(own, camera=replace(own.camera, covariance=own.camera.covariance + spread))
    return replace(
        selection,
        calibration=own,
        assessment=assess(own, circle, selection.candidates),
        warnings=(*times.warnings, *selection.warnings),
        times=times,
    )


def _timed(lens: Calibration, views: Sequence[BoardDetection], progress: Progress) -> TimeCalibration:
    with stage(progress, "times"):
        return time_cameras({CAMERA: TimedCamera(lens, views)}, offsets=False, shutter=True)


def _at_once(views: Sequence[BoardDetection], times: TimeCalibration) -> list[BoardDetection]:
    middles = [times.timed(CAMERA, view).time for view in views]
    return [
        view if middle is None else times.at(CAMERA, view, middle) for view, middle in zip(views, middles, strict=True)
    ]
