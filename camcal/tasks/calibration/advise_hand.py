"""`camcal advise --robot`: the poses of a robot's hand from which hand and eye would be known best."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.formats import boards, cameras, split_address
from camcal.formats.camera_file import CameraFile
from camcal.geometry import rotation as so3
from camcal.options import given_words
from camcal.progress import SILENT, Progress
from camcal.quality.hand_advice import HandAdvice, HandEye, advise_hand
from camcal.quality.view_advice import Known
from camcal.report.table import Column
from camcal.tasks.calibration.advise import known_of_file, pose_words
from camcal.tasks.calibration.options import AdviseOptions

COLUMNS = (
    Column("pose"),
    Column("hand at x y z", "mm"),
    Column("rotation vector", "deg"),
    Column("the board then", wraps=True),
    Column("uncertainty", "mm"),
)
_MILLI = 1e3


@dataclass(frozen=True, eq=False)
class HandAdviceReport:
    """What is known of the camera, and (found) what further poses of the hand would do."""

    known: Known
    found: HandAdvice


def advise(options: AdviseOptions, progress: Progress = SILENT) -> HandAdviceReport:
    """Return the poses of the hand to take next, by a file of `camcal handeye` and the robot's noise.

    Raises InvalidInput for a file without hand and eye or for options of other files, FileError, InsufficientData.
    """
    if given := given_words(AdviseOptions(options.file, model=options.model, image_size=options.image_size)):
        raise InvalidInput(f"{given[0]} applies to detections, not to a file of hand and eye", where=options.file)
    if options.output is not None:
        raise InvalidInput("-o draws views; --robot has no picture", where=str(options.output))
    path, name = split_address(options.file)
    file = cameras.read(path, progress)
    board = None if options.board is None else boards.load_board(options.board)
    known = known_of_file(file, str(path), name, board)
    if known.surface.board.unit != "m":
        raise InvalidInput("the size of the board is not known: give --board with it", where=str(path))
    hand_eye = _hand_eye(file, cameras.name_in(file, name), options.robot or (0.0, 0.0), str(path))
    return HandAdviceReport(known, advise_hand(known, hand_eye, options.count))


def _hand_eye(file: CameraFile, frame: str, noise: tuple[float, float], where: str) -> HandEye:
    for in_hand, names in ((True, (f"hand_T_{frame}", "base_T_board")), (False, (f"base_T_{frame}", "hand_T_board"))):
        if not all(name in file.transforms for name in names):
            continue
        X, Z = (file.transforms[name] for name in names)
        if X.covariance is None or Z.covariance is None:
            break
        covariance = np.zeros((12, 12))
        covariance[:6, :6], covariance[6:, 6:] = X.covariance, Z.covariance
        if (joint := file.joint_covariance) is not None:
            order = [f"{name}.{part}" for name in names for part in ("tx", "ty", "tz", "rx", "ry", "rz")]
            if set(order) <= set(joint.names):
                places = [joint.names.index(name) for name in order]
                covariance = np.asarray(joint.matrix)[np.ix_(places, places)]
        return HandEye(X.pose, Z.pose, covariance, noise, in_hand)
    text = f"has no hand_T_{frame} and base_T_board with covariance: give the file that 'camcal handeye' wrote"
    raise InvalidInput(text, where=where)


def rows(report: HandAdviceReport) -> Iterator[list[str]]:
    """Yield the rows of the table: the suggested poses."""
    for number, each in enumerate(report.found.poses, start=1):
        hand = each.base_T_hand
        place = " ".join(f"{_MILLI * value:.0f}" for value in hand.translation)
        turn = " ".join(f"{value:.1f}" for value in np.degrees(so3.log(hand.rotation)))
        yield [str(number), place, turn, pose_words(report.known, each.view), f"{_MILLI * each.std_m:.3g}"]


def lines(_report: HandAdviceReport) -> Iterator[str]:
    """Yield what is said beside the table."""
    yield "poses out of the robot's reach: take one near to them, from which the board looks alike"


def headline(report: HandAdviceReport) -> str:
    """Return the uncertainty as it is, in words."""
    now, after = report.found.std_m, report.found.poses[-1].std_m
    what = "Uncertainty of where the middle of the board is, by the camera on its mount (1 sigma)"
    return f"{what}: {_MILLI * now:.3g} mm, after these poses {_MILLI * after:.3g} mm"


def document(report: HandAdviceReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {
        "uncertainty_m": report.found.std_m,
        "poses": [
            {
                "base_T_hand": {"t": each.base_T_hand.translation, "rotation_vector": each.base_T_hand.vector()},
                "camera_T_board": {"t": each.view.pose.translation, "rotation_vector": each.view.pose.vector()},
                "words": pose_words(report.known, each.view),
                "uncertainty_m": each.std_m,
            }
            for each in report.found.poses
        ],
    }
