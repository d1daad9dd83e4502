"""When cameras took their images, from calibrations of each alone, and their views as of one moment each."""

from collections.abc import Mapping, Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration
from camcal.calibrate.timing.estimator import TimeEstimate, estimate_times
from camcal.calibrate.timing.problem import OFFSET, RATE, READOUT, TimedCorners
from camcal.calibrate.timing.record import CameraTime, TimeCalibration
from camcal.calibrate.timing.start import Alignment, Track, place_tracks
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.messages import Message, counted
from camcal.solve.steps import SingularError
from camcal.targets.board import Surface
from camcal.targets.detection import BoardDetection

_FEWEST = 20  # views with a time, of each camera
_UNDETERMINED = 0.05  # frame intervals: a standard deviation that leaves a time open
_STIFF = 1.2  # times the noise of views with poses of their own: noise about a smooth motion
_HELD = 0.3  # of a standard deviation, what is left of it where cameras are held: the motion cannot tell the two apart
_STILL = 1.0  # px a frame: RMS motion that is slow


@dataclass(frozen=True, eq=False)
class TimedCamera:
    """A camera calibrated alone, and its views with their times, as its record has them.

    as_designed: whether its offsets of single corners are of no use, as those from views of many moments are.
    """

    calibration: Calibration
    views: Sequence[BoardDetection]
    as_designed: bool = False


def time_cameras(cameras: Mapping[str, TimedCamera], *, offsets: bool, shutter: bool) -> TimeCalibration:
    """Return the times of cameras that saw one board move; the first camera's clock is that of all.

    offsets: whether the clocks are apart; shutter: whether rows of an image are taken one after another.
    Raises InvalidInput for views without a time, InsufficientData where the motion does not tell.
    """
    sources = [_Source.of(name, own) for name, own in cameras.items()]
    board = sources[0].camera.calibration.board
    tracks = [own.track for own in sources]
    found = place_tracks(tracks, board, lags=offsets)
    lost = [name for place, name in enumerate(cameras) if place not in found]
    if lost:
        first = next(iter(cameras))
        text = (
            f"{lost[0]} and {first} see no motion of the board in common: record both while the board moves, by 10°/s "
            "or more, in view of both"
        )
        raise _refused(Message("no_common_motion", text))
    alignments = [found[place] for place in range(len(sources))]
    for name, own in zip(cameras, alignments, strict=True):
        if own.others:
            listed = ", ".join(f"{value:+.4g}" for value in (own.offset, *own.others))
            text = f"the time offset of {name} may be {listed} s: the motion repeats itself; add one that does not"
            raise _refused(Message("several_time_offsets", text))
    try:
        estimate = estimate_times(
            sources[0].surface,
            [own.corners(alignment) for own, alignment in zip(sources, alignments, strict=True)],
            [own.camera.calibration.camera.parameters for own in sources],
            tracks,
            alignments,
            offsets=offsets,
            shutter=shutter,
        )
    except (SingularError, np.linalg.LinAlgError) as error:
        raise InsufficientData("the times are not determined by the motion: turn and move the board more") from error
    return _record(tuple(cameras), sources, estimate)


@dataclass(frozen=True, eq=False)
class _Source:
    """A camera, and which of its views are used: numbers (V,), in the order of time."""

    camera: TimedCamera
    used: tuple[int, ...]

    @classmethod
    def of(cls, name: str, camera: TimedCamera) -> "_Source":
        timed = [
            place
            for place, (record, view) in enumerate(zip(camera.calibration.views, camera.views, strict=True))
            if record.camera_T_board is not None and view.time is not None
        ]
        if not timed and any(view.found for view in camera.views):
            raise InvalidInput(f"no times of the images{_of(name)}: set --timestamps or --fps")
        if len(timed) < _FEWEST:
            text = f"{counted(len(timed), 'image')}{_of(name)} of the moving board; at least {_FEWEST} are needed"
            raise _refused(Message("too_few_timed_views", text))
        order = sorted(timed, key=lambda place: camera.views[place].time or 0.0)
        times = np.array([camera.views[place].time for place in order])
        if not (np.diff(times) > 0).all():
            again = order[int(np.flatnonzero(~(np.diff(times) > 0))[0]) + 1]
            raise InvalidInput("has the time of another image", where=camera.views[again].image)
        return cls(camera, tuple(order))

    @property
    def surface(self) -> Surface:
        """The board as its calibration has it."""
        own = self.camera.calibration.surface
        return replace(own, offsets=None) if self.camera.as_designed else own

    @property
    def track(self) -> Track:
        """The poses of the views."""
        poses = [self.camera.calibration.views[place].camera_T_board for place in self.used]
        known = [own for own in poses if own is not None]
        times = np.array([self.camera.views[place].time for place in self.used])
        return Track(times, np.stack([own.rotation for own in known]), np.stack([own.translation for own in known]))

    def ids(self, place: int, alignment: Alignment) -> Array:
        """Return the points (N,) of the board that a view shows, as the first camera numbers the board."""
        board = self.camera.calibration.board
        symmetries = np.stack(board.symmetries())
        own = symmetries[self.camera.calibration.views[place].symmetry][self.camera.views[place].ids]
        return np.asarray(np.argsort(symmetries[alignment.symmetry])[own])

    def corners(self, alignment: Alignment) -> TimedCorners:
        """Return the corners of the views that are used."""
        camera, views = self.camera.calibration.camera, [self.camera.views[place] for place in self.used]
        counts = [len(view.ids) for view in views]
        pixels = np.concatenate([view.pixels for view in views]).T
        names = camera.model.parameter_names
        return TimedCorners(
            camera.model,
            np.array([place for place, name in enumerate(names) if name not in camera.fixed], np.intp),
            pixels=pixels,
            ids=np.concatenate([self.ids(place, alignment) for place in self.used]),
            stamps=np.repeat([float(view.time or 0.0) for view in views], counts),
            rows=pixels[1] / camera.image_size[1],
            weights=np.concatenate([_weights(view) for view in views]),
            sigma=self.camera.calibration.sigma_px,
            lens_spread=camera.model.prior_std(camera.image_size, float(camera.parameters[0])),
        )


def _weights(view: BoardDetection) -> Array:
    """Return the weights (N,) of corners: the precision of a typical direction, 1 where it is not known."""
    if view.covariance is None:
        return np.ones(len(view.ids))
    return np.asarray(1 / np.sqrt(np.linalg.det(view.covariance)))


def _refused(failure: Message) -> InsufficientData:
    return InsufficientData(failure.text, failures=[failure])


def _record(names: tuple[str, ...], sources: Sequence[_Source], estimate: TimeEstimate) -> TimeCalibration:
    state, problem = estimate.state, estimate.problem
    times = {}
    for camera, name in enumerate(names):
        reference = float(estimate.references[camera])
        offset = float(state.times[OFFSET, camera]) - (reference - float(estimate.references[0]))
        middle = estimate.middle_offset(camera)
        times[name] = CameraTime(
            offset,
            estimate.std(OFFSET, camera),
            float(state.times[RATE, camera]),
            estimate.std(RATE, camera),
            reference,
            float(state.times[READOUT, camera]) if problem.free[READOUT, camera] else None,
            estimate.std(READOUT, camera),
            *((offset + middle[0], middle[1]) if middle else ()),
        )
    result = TimeCalibration(times, estimate.interval, estimate, {}, ())
    moved = {
        name: {own.camera.views[place].image: own.ids(place, estimate.alignments[camera]) for place in own.used}
        for camera, (name, own) in enumerate(zip(names, sources, strict=True))
    }
    result = replace(result, ids=moved)
    return replace(result, warnings=tuple(_warnings(result, sources)))


def _of(name: str) -> str:
    """Return whose something is, nothing for a camera alone, which has no name."""
    return f" of {name}" if name else ""


def _warnings(result: TimeCalibration, sources: Sequence[_Source]) -> list[Message]:
    """Return what is not determined, and where the motion is not as smooth as it is taken to be."""
    found, estimate, interval = [], result.estimate, result.interval
    for camera, (name, own) in enumerate(result.cameras.items()):
        speed = result.speed_px(name)
        slow = f"the board moves by {speed:.2g} px a frame only: move it faster"
        alike = slow if speed < _STILL else "the motion is alike throughout: turn and move the board to and fro"
        if own.offset_std > _UNDETERMINED * interval:
            why = alike
            if _with_cameras_held(estimate, camera) < _HELD * own.offset_std:
                why = "the board moves in one direction only, evenly: move it to and fro"
            text = f"time offset{_of(name)} not determined (± {1e3 * own.offset_std:.2g} ms): {why}"
            found.append(Message("undetermined_time_offset", text, {"std_s": own.offset_std}))
        if own.readout_std > _UNDETERMINED * interval:
            text = f"readout time{_of(name)} not determined (± {1e3 * own.readout_std:.2g} ms): {alike}"
            found.append(Message("undetermined_readout_time", text, {"std_s": own.readout_std}))
        noise, free = estimate.problem.cameras[camera].sigma, sources[camera].camera.calibration.sigma_px
        left = estimate.unresolved[READOUT, camera]
        if 2 * left**2 > own.readout_std**2 > 0:
            text = (
                f"motion too fast for the frame rate: frames do not show all of it, which is {1e3 * left:.2g} of the "
                f"± {1e3 * own.readout_std:.2g} ms of the readout time{_of(name)}; move more slowly, or check the time "
                "stamps"
            )
            found.append(Message("motion_too_fast", text, {"unresolved_s": left}))
        elif estimate.stiff and noise > _STIFF * free:
            text = (
                f"motion too fast for the frame rate: residuals{_of(name)} {noise:.2g} px about a smooth motion, "
                f"{free:.2g} px otherwise; move more slowly, or check the time stamps"
            )
            found.append(Message("motion_too_fast", text, {"noise_px": noise}))
    return found


def _with_cameras_held(estimate: TimeEstimate, camera: int) -> float:
    """Return the standard deviation that a camera's offset has where the cameras' places are known."""
    problem, covariance = estimate.problem, estimate.covariance
    column = problem.time_columns[OFFSET, camera]
    poses = slice(problem.lens_starts[-1], problem.board_start)
    cross = covariance[poses, column]
    left = covariance[column, column] - cross @ np.linalg.solve(covariance[poses, poses], cross)
    return float(np.sqrt(max(left, 0.0)))
