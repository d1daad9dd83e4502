"""Times of cameras, and views as they would be had all rows been taken at one moment."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.calibrate.timing.estimator import TimeEstimate
from camcal.messages import Message
from camcal.records import Brief
from camcal.targets.detection import BoardDetection


@dataclass(frozen=True)
class CameraTime:
    """When a camera took its images, s: row y of H at stamp + offset + rate · (stamp - reference) + readout · y / H, in
    the time of the first camera. readout: None where it was not estimated. Standard deviations are 0 for what is held.
    """

    offset: float
    offset_std: float
    rate: float
    rate_std: float
    reference: float
    readout: float | None = None
    readout_std: float = 0.0


@dataclass(frozen=True, eq=False)
class TimeCalibration(Brief):
    """The times of cameras by their names. interval: s, between frames. ids: by the names of cameras and images, the
    points (N,) of the board that a view shows, as the first camera numbers it.
    """

    cameras: Mapping[str, CameraTime]
    interval: float
    estimate: TimeEstimate
    ids: Mapping[str, Mapping[str, Array]]
    warnings: tuple[Message, ...] = ()

    def timed(self, camera: str, view: BoardDetection) -> BoardDetection:
        """Return a view with the mean time of its corners in the time of the first camera."""
        if view.time is None or not view.found:
            return view
        rows = view.pixels[:, 1] / view.size[1]
        return replace(view, time=float(self._times(camera, view, rows).mean()))

    def at(self, camera: str, view: BoardDetection, time: float) -> BoardDetection:
        """Return a view with its corners where they were at a time of the first camera; as it is where the motion is
        not known.
        """
        moved = self._moved(camera, view, time)
        return view if moved is None else replace(view, pixels=view.pixels + moved, time=time)

    def speed_px(self, camera: str) -> float:
        """Return by how much corners move from frame to frame, RMS, px."""
        estimate, place = self.estimate, list(self.cameras).index(camera)
        own, state = estimate.problem.cameras[place], estimate.state
        times = state.of_rows(place, own.stamps, own.rows)
        half = 0.25 * estimate.interval
        sides = [self._pixels(place, own.ids, times + side) for side in (-half, half)]
        return float(np.sqrt(np.nanmean(np.sum((sides[1] - sides[0]) ** 2, axis=0)))) * estimate.interval / (2 * half)

    def _times(self, camera: str, view: BoardDetection, rows: Array) -> Array:
        place = list(self.cameras).index(camera)
        state, reference = self.estimate.state, self.estimate.references
        stamps = np.full(len(rows), float(view.time or 0.0) - reference[place])
        return np.asarray(state.of_rows(place, stamps, rows) + reference[0])

    def _moved(self, camera: str, view: BoardDetection, time: float) -> Array | None:
        ids = self.ids[camera].get(view.image)
        if ids is None or view.time is None:
            return None
        place, start = list(self.cameras).index(camera), self.estimate.references[0]
        times = self._times(camera, view, view.pixels[:, 1] / view.size[1]) - start
        there = np.full(len(times), time - start)
        if not self.estimate.state.motion.knots.contain(np.concatenate([times, there])):
            return None
        moved = (self._pixels(place, ids, there) - self._pixels(place, ids, times)).T
        return moved if np.isfinite(moved).all() else None

    def _pixels(self, place: int, ids: Array, times: Array) -> Array:
        """Return where a camera sees points ids (M,) of the board at times (M,), less the first camera's reference."""
        estimate = self.estimate
        model, lens = estimate.problem.cameras[place].model, estimate.state.lenses[place]
        return np.asarray(model.project(lens, estimate.problem.seen(estimate.state, place, times, ids).T).pixels.T)

    def spread(self, names: tuple[str, ...]) -> FloatArray:
        """Return what not knowing the times adds to the covariance (n, n) of lenses and transforms, by their names, such
        as left.fx and right_T_left.tx; 0 for what is not among them.
        """
        problem, covariance = self.estimate.problem, self.estimate.covariance
        times = np.arange(problem.times_start, problem.shared)
        known = problem.names(tuple(self.cameras))
        by_times = np.linalg.solve(covariance[np.ix_(times, times)], covariance[times])
        spread = by_times.T @ covariance[times]
        places = [known.index(name) if name in known else -1 for name in names]
        padded = np.pad(spread, (0, 1))
        return np.asarray(padded[np.ix_(places, places)])
