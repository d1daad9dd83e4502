"""Times of cameras, and views as they would be had all rows been taken at one moment."""

from collections.abc import Mapping, Sequence

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.calibrate.timing.estimator import TimeEstimate
from camcal.dataclass import dataclass, replace
from camcal.messages import Message
from camcal.records import Brief
from camcal.targets.detection import BoardDetection


@dataclass(frozen=True)
class CameraTime:
    """When a camera took its images, s: row y of H at stamp + offset + rate · (stamp - reference) + readout · y / H, in
    the time of the first camera. readout: None where it was not estimated. Standard deviations are 0 for what is held.
    middle_offset: between the middle rows of both cameras, which the motion shows far better than the first ones'; None
    where nothing or one of both times is held.
    """

    offset: float
    offset_std: float
    rate: float
    rate_std: float
    reference: float
    readout: float | None = None
    readout_std: float = 0.0
    middle_offset: float | None = None
    middle_offset_std: float = 0.0


@dataclass(frozen=True, eq=False)
class CameraTimes(Brief):
    """The times of cameras by their names. interval: s, between frames."""

    cameras: Mapping[str, CameraTime]
    interval: float


@dataclass(frozen=True, eq=False)
class TimeCalibration(CameraTimes):
    """How the times of cameras were found. ids: by the names of cameras and images, the points (N,) of the board that a
    view shows, as the first camera numbers it.
    """

    estimate: TimeEstimate
    ids: Mapping[str, Mapping[str, Array]]
    warnings: tuple[Message, ...] = ()

    def timed(self, camera: str, view: BoardDetection) -> BoardDetection:
        """Return a view with the mean time of its corners in the time of the first camera."""
        return (
            replace(view, time=float(self._times(camera, view).mean()))
            if view.time is not None and view.found
            else view
        )

    def at(self, camera: str, views: Sequence[BoardDetection], times: Sequence[float | None]) -> list[BoardDetection]:
        """Return views with their corners where they were at times of the first camera; as they are where there is no
        time or the motion is not known.
        """
        known = [
            place
            for place, (view, time) in enumerate(zip(views, times, strict=True))
            if time is not None and view.time is not None and view.image in self.ids[camera]
        ]
        if not known:
            return list(views)
        counts = [len(views[place].ids) for place in known]
        place, start = list(self.cameras).index(camera), self.estimate.references[0]
        taken = np.concatenate([self._times(camera, views[row]) for row in known]) - start
        wanted = np.repeat([float(times[row] or 0.0) for row in known], counts) - start
        ids = np.concatenate([self.ids[camera][views[row].image] for row in known])
        knots = self.estimate.state.motion.knots
        inside = knots.contain(taken) & knots.contain(wanted)
        moved = np.full((len(ids), 2), np.nan)
        before, after = (self._pixels(place, ids[inside], own[inside]) for own in (taken, wanted))
        moved[inside] = (after - before).T
        result = list(views)
        for row, own in zip(known, np.split(moved, np.cumsum(counts)[:-1]), strict=True):
            if np.isfinite(own).all():
                result[row] = replace(views[row], pixels=views[row].pixels + own, time=times[row])
        return result

    def speed_px(self, camera: str) -> float:
        """Return by how much corners move from frame to frame, RMS, px."""
        estimate, place = self.estimate, list(self.cameras).index(camera)
        own, state = estimate.problem.cameras[place], estimate.state
        times = state.of_rows(place, own.stamps, own.rows)
        half = 0.25 * estimate.interval
        sides = [self._pixels(place, own.ids, times + side) for side in (-half, half)]
        return float(np.sqrt(np.nanmean(np.sum((sides[1] - sides[0]) ** 2, axis=0)))) * estimate.interval / (2 * half)

    def _times(self, camera: str, view: BoardDetection) -> Array:
        place = list(self.cameras).index(camera)
        state, reference = self.estimate.state, self.estimate.references
        stamps = np.full(len(view.ids), float(view.time or 0.0) - reference[place])
        return np.asarray(state.of_rows(place, stamps, view.pixels[:, 1] / view.size[1]) + reference[0])

    def _pixels(self, place: int, ids: Array, times: Array) -> Array:
        """Return where a camera sees points ids (M,) of the board at times (M,), less the first camera's reference."""
        estimate = self.estimate
        model, lens = estimate.problem.cameras[place].model, estimate.state.lenses[place]
        return np.asarray(model.project(lens, estimate.problem.seen(estimate.state, place, times, ids).T).pixels.T)

    def spread(self, names: tuple[str, ...]) -> FloatArray:
        """Return what not knowing the times adds to the covariance (n, n) of lenses and transforms, by their names,
        such as left.fx and right_T_left.tx; 0 for what is not among them.
        """
        problem, covariance = self.estimate.problem, self.estimate.covariance
        times = np.arange(problem.times_start, problem.shared)
        known = problem.names(tuple(self.cameras))
        by_times = np.linalg.solve(covariance[np.ix_(times, times)], covariance[times])
        spread = by_times.T @ covariance[times]
        places = [known.index(name) if name in known else -1 for name in names]
        padded = np.pad(spread, (0, 1))
        return np.asarray(padded[np.ix_(places, places)])
