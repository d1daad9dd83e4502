"""What a calibration is judged by: every criterion, its limit, whether it is a failure or a warning, and its source.

A failure makes a result untrustworthy; a warning says what is weak but usable.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Criterion:
    """One rule of the verdict.

    limit: beyond which it applies, in `unit`. floor_px: however small the noise, less than this is not worth a word.
    source: where the limit is from.
    """

    code: str
    failure: bool
    limit: float
    unit: str
    means: str
    source: str
    floor_px: float = 0.0


_SETS = "24 real sets, halves of them, and simulations"
_RULE = "usual practice"

_ALL = (
    Criterion(
        "not_invertible",
        True,
        1.05,
        "distance to the outermost corner",
        "the distortion stops being invertible nearer to the outermost corner than this",
        _SETS,
    ),
    Criterion(
        "lens_model",
        True,
        0.3,
        "noise",
        "the mean residual of a ring about the principal point points outwards or inwards by more than this, beyond "
        "chance (1e-6)",
        _SETS,
        floor_px=0.02,
    ),
    Criterion("focal_length", True, 0.01, "focal length", "the standard deviation of the focal length", _SETS),
    Criterion(
        "focal_length_few_views",
        True,
        0.007,
        "focal length",
        "the same with fewer than 10 views, times the factor by which Student's distribution widens the interval of "
        "95 %",
        "912 subsets of 3 to 7 views of 24 real sets: of 592 trusted ones 2.2 % are off by more than 1 %",
    ),
    Criterion(
        "several_cameras",
        True,
        1.4,
        "ratio",
        "errors of corners with one lens over those with two, each for a group of views of its own, less a standard "
        "error",
        "24 real sets of one camera (at most 1.31), 23 mixtures of similar cameras (19 above 1.5), and simulations",
        floor_px=0.02,
    ),
    Criterion(
        "several_cameras_by_name",
        True,
        1.2,
        "ratio",
        "the same with groups that the file names suggest, which are not chosen to make it large",
        "the same sets, split by the order of their views (at most 1.07)",
        floor_px=0.02,
    ),
    Criterion(
        "focal_change",
        True,
        3.6,
        "standard deviations",
        "the focal length changes from one view on, or drifts: how far beyond chance; the floor is the change in the "
        "corner of the image",
        _SETS,
        floor_px=0.5,
    ),
    Criterion(
        "parallel_views",
        True,
        0.003,
        "focal length",
        "the standard deviation of the focal length where the board was never tilted by more than 15 degrees",
        _SETS,
    ),
    Criterion(
        "partly_invertible",
        False,
        0.99,
        "distance to the image corner",
        "the distortion stops being invertible before this, beyond all corners: masked there",
        _SETS,
    ),
    Criterion("few_views", False, 10, "views", "fewer views than this", _RULE),
    Criterion("tilt", False, 15, "degrees", "the board was never tilted by more than this", _RULE),
    Criterion(
        "extrapolated", False, 0.8, "distance to the image corner", "no corner lies further out than this", _RULE
    ),
    Criterion("coverage", False, 0.6, "image", "the share of a 10 x 8 grid with a corner in it", _RULE),
    Criterion("noise", False, 0.5, "px", "the noise of a coordinate, where 0.1 px is usual", _RULE),
    Criterion("rejected", False, 0.02, "corners", "the share of rejected corners", _RULE),
    Criterion(
        "rolling_shutter",
        False,
        0.5,
        "px",
        "rows of a typical image are apart by more than this",
        _SETS,
    ),
    Criterion("board_bends", False, 2e-4, "board's longer side", "RMS height by which the board bends", _SETS),
    Criterion(
        "focal_varies",
        False,
        3.0,
        "standard deviations",
        "the focal length of single views differs, or varies from view to view, or a change of it is less clear than "
        "that of focal_change",
        _SETS,
        floor_px=2.5,
    ),
    Criterion(
        "two_boards",
        False,
        3.7,
        "standard deviations",
        "the board changes from one view on: how far beyond chance; the floor is the RMS distance of its corners where "
        "they, not its proportions, show it",
        _SETS,
        floor_px=0.08,
    ),
    Criterion(
        "motion_blur",
        False,
        4.0,
        "ratio of variances",
        "corners of a view scatter in one direction by more than this against across, and against a typical view; the "
        "floor is their standard deviation",
        _SETS,
        floor_px=0.1,
    ),
    Criterion("board_size", False, 3.0, "m", "the longer side of the board: was it given in mm?", _RULE),
    Criterion(
        "focal_ratio", False, 0.05, "ratio", "fx and fy differ by more than this: pixels that are not square?", _RULE
    ),
    Criterion(
        "principal_point",
        False,
        0.15,
        "image size",
        "the principal point is further from the middle of the image than this: a cropped image?",
        _RULE,
    ),
    Criterion("unit", False, 0, "", "the size of the board is not known", _RULE),
    Criterion("bent_board", False, 0.002, "board's longer side", "the deflection of the board, if it is clear", _RULE),
    Criterion("correlation", False, 0.9, "", "a scale of the board and a focal length are correlated", _RULE),
)
CRITERIA = {criterion.code: criterion for criterion in _ALL}


@dataclass(frozen=True)
class Finding:
    """A criterion that applies: its code, whether it is a failure, and in words what was found and what to do.

    value: what was found, in the criterion's unit. images: those concerned, none where it is all of them.
    """

    code: str
    failure: bool
    text: str
    value: float
    images: tuple[str, ...] = ()


def finding(code: str, text: str, value: float, images: tuple[str, ...] = ()) -> Finding:
    """Return the finding of a criterion of the table."""
    return Finding(code, CRITERIA[code].failure, text, float(value), images)
