"""Captures of cameras that did not expose together: their times by the motion of the board, views as of one moment."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from camcal.calibrate.intrinsics import Calibration
from camcal.calibrate.rigs.record import RigCalibration
from camcal.calibrate.timing.calibrate import TimedCamera, time_cameras
from camcal.calibrate.timing.record import TimeCalibration
from camcal.errors import InsufficientData
from camcal.tasks.rigs.matching import matched
from camcal.tasks.rigs.options import TIME, RigSettings
from camcal.tasks.rigs.rig_views import RigViews


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
