"""Calibration of the cameras of a rig from captures of a board."""

from camcal.calibrate.rigs.captures import Captures
from camcal.calibrate.rigs.record import RigCalibration, RigOptions
from camcal.targets.board import Board

__all__ = ["Captures", "RigCalibration", "RigOptions", "calibrate_rig"]


def calibrate_rig(captures: Captures, board: Board, options: RigOptions) -> RigCalibration:
    """Return the cameras that saw a board in `captures` and where they are.

    Raises InsufficientData where no two cameras can be linked or a camera cannot be calibrated, NotConverged,
    InvalidInput.
    """
    raise NotImplementedError
