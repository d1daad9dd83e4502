"""When cameras took their images, by the motion of the board, and views as of one moment each.

The readout time of one camera, for `camcal calibrate --rolling-shutter`; and the times of the captures of cameras that
did not expose together, for `camcal rig`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from camcal.calibrate.intrinsics import Calibration
from camcal.calibrate.rigs.record import RigCalibration
from camcal.calibrate.timing.calibrate import TimedCamera, time_cameras
from camcal.calibrate.timing.record import TimeCalibration
from camcal.cameras.validity import ImageCircle
from camcal.errors import InsufficientData
from camcal.progress import Progress, stage
from camcal.quality.assess import assess
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.board_views import BoardViews
from camcal.tasks.calibration.model_selection import Selection
from camcal.tasks.poses.frame_times import frame_times
from camcal.tasks.rigs.matching import matched
from camcal.tasks.rigs.options import TIME, RigSettings
from camcal.tasks.rigs.rig_views import RigViews
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


def synchronised(
    seen: RigViews, lenses: Mapping[str, Calibration], settings: RigSettings
) -> tuple[RigViews, TimeCalibration]:
    """Return the captures of views as they would be had all of each been taken at once, and the times of the cameras.

    lenses: calibrations of the cameras, from the views of `seen`. Raises as `time_cameras` does.
    """
    names = seen.captures.cameras
    without = [name for name in names if name not in lenses]
    if without:
        raise InsufficientData(f"camera {without[0]}: its images alone do not hold a lens, which its times need")
    times = time_cameras(
        {name: TimedCamera(lenses[name], seen.of(name), as_designed=True) for name in names},
        offsets=settings.time_offset,
        shutter=settings.rolling_shutter,
    )
    by_image = {name: {view.image: view for view in seen.of(name)} for name in names}
    timed = {name: [times.timed(name, view) for view in own.values()] for name, own in by_image.items()}
    found = matched(timed, TIME, settings.tolerance)
    moments = [
        float(np.mean([view.time for view in row if view is not None and view.time is not None]))
        for row in found.captures.views
    ]
    columns = []
    for place, name in enumerate(names):
        own = [(k, row[place]) for k, row in enumerate(found.captures.views)]
        shown = [(k, by_image[name][view.image]) for k, view in own if view is not None]
        moved = times.at(name, [view for _, view in shown], [moments[k] for k, _ in shown])
        placed = dict(zip((k for k, _ in shown), moved, strict=True))
        columns.append([placed.get(k) for k, _ in own])
    captures = replace(found.captures, views=tuple(zip(*columns, strict=True)))
    lines = (*seen.lines, found.line)
    return replace(seen, matched=replace(found, captures=captures), lines=lines), times


def with_times(calibration: RigCalibration, times: TimeCalibration) -> RigCalibration:
    """Return a rig with the times of its cameras, and its covariances with what not knowing these adds."""
    covariance = calibration.covariance + times.spread(calibration.names)
    calibrations = {}
    for name, own in calibration.calibrations.items():
        camera = own.camera
        if camera.covariance is not None:
            spread = times.spread(tuple(f"{name}.{each}" for each in camera.model.parameter_names))
            camera = replace(camera, covariance=camera.covariance + spread)
        calibrations[name] = replace(own, camera=camera)
    warnings = (*times.warnings, *calibration.warnings)
    return replace(calibration, covariance=covariance, calibrations=calibrations, times=times, warnings=warnings)
