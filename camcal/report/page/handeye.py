"""The page of hand and eye: the transforms, the noise of the robot, and the errors of its poses."""

import numpy as np

from camcal.messages import counted
from camcal.report.figures.handeye import hand_places, robot_errors
from camcal.report.handeye import COLUMNS, POSE_COLUMNS, HandEyeReport, noise_words, pose_rows, rows
from camcal.report.page.record import GOOD, WEAK, Figure, Page, PageVerdict, Section, Table, shown_messages
from camcal.report.page.thumbnails import pictures

_MILLI = 1e3


def handeye_page(report: HandEyeReport, robot: str, made: str) -> Page:
    """Return the page of hand and eye; robot: the file of its poses."""
    (name, first), *_ = report.transforms.items()
    std = np.sqrt(np.diag(np.asarray(first.covariance)))
    place, turn = _MILLI * float(np.sqrt(np.mean(std[:3] ** 2))), float(np.degrees(np.sqrt(np.mean(std[3:] ** 2))))
    count = len(report.warnings)
    state, headline = (WEAK, f"Usable, with {counted(count, 'warning')}") if count else (GOOD, "Trustworthy")
    remedy = "The warnings say what is weak, and how to improve it." if count else ""
    known = f"{name} is known to {place:.2g} mm and {turn:.2g}°."
    plots = robot_errors(report.estimate, report.images, report.doubtful), hand_places(report.estimate)
    (shift, *_), (angle, *_) = report.noise
    return Page(
        "Hand and eye",
        f"{counted(len(report.images), 'pose')} of {robot}, read as {report.words}",
        PageVerdict(state, headline, known, remedy),
        shown_messages((), report.warnings),
        figures=[
            Figure(f"Position of {name}", f"± {place:.2g} mm", "1 standard deviation of a coordinate"),
            Figure(f"Rotation of {name}", f"± {turn:.2g}°", "1 standard deviation about an axis"),
            Figure("Position noise of the robot", f"{_MILLI * shift:.2g} mm", "1 standard deviation of a coordinate"),
            Figure("Rotation noise of the robot", f"{np.degrees(angle):.2g}°", "1 standard deviation about an axis"),
        ],
        sections=(
            Section(
                "transforms",
                "Transforms",
                lines=(noise_words(report),),
                tables=(Table.under("Transforms", COLUMNS, rows(report)),),
            ),
            Section(
                "robot",
                "Poses of the robot",
                pictures=tuple(pictures(plots).values()),
                tables=(Table.under("Errors of the robot's poses", POSE_COLUMNS, pose_rows(report)),),
            ),
        ),
        made=made,
    )
