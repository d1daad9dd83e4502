"""The pages of a check and of hand and eye.

A check: what new images say of a calibration, with maps of what it leaves open and of the drift. Hand and eye: the
transforms, the noise of the robot, and figures of the errors of its poses and of where the hand was.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.ticker import MaxNLocator

from camcal.arrays import Array
from camcal.calibrate.robot.estimator import RobotEstimate
from camcal.cameras.directions import projection_covariances
from camcal.messages import counted
from camcal.quality.camera_check import DRIFTED, NOT_SHOWN, VALID, WORDS, Checked, CheckedCamera
from camcal.quality.camera_drift import LensDrift, drift_grid
from camcal.quality.projection_uncertainty import ProjectionUncertainty
from camcal.report.figures.calibration import short_name
from camcal.report.figures.differences import lens_drift
from camcal.report.figures.figure import WIDTH, Plot, Theme
from camcal.report.figures.image_plane import magnification, projection_uncertainty
from camcal.report.handeye import COLUMNS, DOUBTFUL, POSE_COLUMNS, HandEyeReport, noise_words, pose_rows, rows
from camcal.report.page.record import (
    BAD,
    GOOD,
    UNKNOWN,
    WARNING,
    WEAK,
    Figure,
    Page,
    PageVerdict,
    Section,
    ShownMessage,
    Table,
    shown_messages,
)
from camcal.report.page.record import Figure as KeyFigure
from camcal.report.page.thumbnails import pictures

_STATES = {VALID: GOOD, DRIFTED: BAD, NOT_SHOWN: UNKNOWN}
_REMEDIES = {
    VALID: "",
    DRIFTED: "Calibrate again, or undo what has changed.",
    NOT_SHOWN: "Take the images that are named below, and check again.",
}
_HEADS = ("what", "verdict", "drift, px", "± std", "limit, px", "smallest shown, px", "images")

_MILLI = 1e3

_SPREAD = 2.7955  # standard deviations of a coordinate, below which 95 % of the lengths of three of them are
_LABELLED = 5  # poses that are named
_LONG = 4.0  # times as long as arrows are elsewhere: there are few
_PLANES = ((0, 1), (0, 2))


def check_page(
    found: Mapping[str, Checked], cameras: Mapping[str, CheckedCamera], file: str, verdict: str, made: str
) -> Page:
    """Return the page of what was found of cameras and mounts; file: the camera file, verdict: that on all of them."""
    worst = [f"{name}: {each.reason}" for name, each in found.items() if each.verdict == verdict]
    headline = WORDS[verdict].capitalize()
    notes = [
        ShownMessage(WARNING, "check_image", note, where=name) for name, each in found.items() for note in each.notes
    ]
    checks = Section("checks", "Checks", tables=(Table.of("Cameras and mounts", _HEADS, list(_rows(found))),))
    images = max(each.views for each in found.values())
    return Page(
        f"Check of {file}",
        f"{counted(len(found), 'check')} by {counted(images, 'image')} with the board",
        PageVerdict(_STATES[verdict], headline, ". ".join(worst), _REMEDIES[verdict]),
        notes,
        figures=[KeyFigure(name, WORDS[each.verdict], each.cause) for name, each in found.items()],
        sections=(checks, *_lenses(found, cameras)),
        made=made,
    )


def _rows(found: Mapping[str, Checked]) -> Iterator[Sequence[object]]:
    for name, each in found.items():
        drift = each.drift
        figures = (drift.rms_px.value, drift.rms_px.std, each.limit_px, drift.smallest_px) if drift else (None,) * 4
        yield name, each.words, *(None if value is None else f"{value:.2g}" for value in figures), each.views


def _lenses(found: Mapping[str, Checked], cameras: Mapping[str, CheckedCamera]) -> Iterator[Section]:
    """Yield a section for every lens: what its calibration leaves open, and how it has drifted."""
    for name, each in found.items():
        if not isinstance(each.drift, LensDrift):
            continue
        camera = cameras[name].camera
        u, v = drift_grid(camera.image_size)
        covariances = projection_covariances(camera, each.drift.pixels)
        before = ProjectionUncertainty(u, v, covariances, each.drift.inside)
        plots = (projection_uncertainty(before, camera.image_size), lens_drift(each.drift))
        shown = pictures(plots, f"{name}-")
        yield Section(name, f"Lens of {name}", lines=(each.words,), pictures=tuple(shown.values()))


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


def robot_errors(found: RobotEstimate, images: Sequence[str], doubtful: Sequence[str]) -> Plot:
    """Return the errors of the robot's poses in their order, of position and rotation; images: their N names."""
    lengths = (
        _MILLI * np.linalg.norm(found.residuals[:, :3], axis=1),
        np.degrees(np.linalg.norm(found.residuals[:, 3:], axis=1)),
    )
    sigmas = _MILLI * found.sigmas[0], float(np.degrees(found.sigmas[1]))
    off = np.array([image in doubtful for image in images])
    rms = [float(np.sqrt(np.mean(own**2))) for own in lengths]

    def draw(figure: FigureBase, theme: Theme) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        for axes, own, sigma, label in zip(
            (upper, lower), lengths, sigmas, ("position, mm", "rotation, deg"), strict=True
        ):
            top = 1.4 * max(_SPREAD * sigma, float(own[~off].max(initial=0.0)))
            _draw_errors(axes, np.minimum(own, top), _SPREAD * sigma, off, theme)
            axes.set_ylabel(label)
            for place in np.flatnonzero(off & (own > top))[:_LABELLED]:
                words = f"  {short_name(images[place])}: {own[place]:.2g}  "
                side = "left" if place < len(off) / 2 else "right"
                axes.annotate(words, (place + 1, top), fontsize=7, va="center", ha=side)
        lower.set_xlabel("pose")
        lower.xaxis.set_major_locator(MaxNLocator(integer=True))

    return Plot(
        "robot_errors",
        "Errors of the robot's poses",
        "How far the robot's poses are from what the camera says: the length of the error of position and its angle, "
        f"{rms[0]:.2g} mm and {rms[1]:.2g}° RMS. 95 % of Gaussian errors are below the dashed lines; circles: poses "
        "that fit no other, and hardly count; where they are farther off than is drawn, it is written.",
        f"Errors of {len(images)} poses, {rms[0]:.2g} mm and {rms[1]:.2g} degrees RMS; {off.sum()} fit no other.",
        draw,
        (WIDTH, 4.2),
    )


def _draw_errors(axes: Axes, lengths: Array, limit: float, off: Array, theme: Theme) -> None:
    numbers = np.arange(1, len(lengths) + 1)
    axes.vlines(numbers, 0, lengths, colors=theme.faint, lw=1)
    axes.plot(numbers[~off], lengths[~off], "o", color=theme.series[0], ms=4)
    axes.plot(numbers[off], lengths[off], "o", color=theme.bad, ms=6, mfc="none", mew=1.5)
    axes.axhline(limit, color=theme.ink, ls="--", lw=1)
    axes.set_ylim(0, 1.1 * max(limit, float(lengths.max())))
    axes.grid(visible=True, axis="y")


def hand_places(found: RobotEstimate) -> Plot:
    """Return where the hand was in the base, from above and from the side, with the errors of position as arrows."""
    robot = found.problem.robot
    places, counted = robot.base_T_hand.translations, found.weights >= DOUBTFUL
    errors = np.where(counted[:, None], found.residuals[:, :3], 0.0)
    still = (found.world_T_board if robot.in_hand else found.carrier_T_rig).translation
    shown = np.vstack([places, still])
    extent = float(np.ptp(shown, axis=0).max()) or 1.0
    factor = magnification(np.linalg.norm(errors[counted], axis=1), _LONG * extent)
    what = "board" if robot.in_hand else "camera"
    reach = _MILLI * np.ptp(places, axis=0)

    def draw(figure: FigureBase, theme: Theme) -> None:
        for axes, plane in zip(figure.subplots(1, 2), _PLANES, strict=True):
            at, off = places[:, plane], factor * errors[:, plane]
            axes.quiver(*at.T, *off.T, angles="xy", scale_units="xy", scale=1, color=theme.series[1], width=0.006)
            axes.plot(*at[counted].T, "o", color=theme.series[0], ms=4, label="hand")
            axes.plot(*at[~counted].T, "o", color=theme.bad, ms=6, mfc="none", mew=1.5)
            axes.plot(*still[list(plane)], "s", color=theme.series[2], ms=7, label=what)
            ends = np.concatenate([at, at + off, still[None, plane]])
            middle = (ends.max(axis=0) + ends.min(axis=0)) / 2
            half = 0.56 * float(np.ptp(shown, axis=0).max()) or 1.0
            half = max(half, 0.56 * float(np.ptp(ends, axis=0).max()))
            axes.set_xlim(middle[0] - half, middle[0] + half)
            axes.set_ylim(middle[1] - half, middle[1] + half)
            axes.set_aspect("equal")
            axes.set_xlabel(f"{'xyz'[plane[0]]}, m")
            axes.set_ylabel(f"{'xyz'[plane[1]]}, m")
            axes.grid(visible=True)
            axes.locator_params(nbins=5)
        axes.legend(loc="best", fontsize=7)

    return Plot(
        "hand_places",
        "Where the hand was",
        f"Positions of the hand in the robot's base, from above and from the side; the {what} stands still. Arrows: "
        f"errors of position, {factor:.3g} times as long as they are; errors that point the same way nearby are "
        "systematic. Circles: poses that fit no other.",
        f"{len(places)} positions of a hand over {reach[0]:.0f} x {reach[1]:.0f} x {reach[2]:.0f} mm.",
        draw,
        (1.5 * WIDTH, 3.9),
    )
