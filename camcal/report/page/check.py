"""The page of a check: what new images say of a calibration, with maps of what it leaves open and of the drift."""

from collections.abc import Iterator, Mapping, Sequence

from camcal.cameras.directions import projection_covariances
from camcal.messages import counted
from camcal.quality.camera_check import DRIFTED, NOT_SHOWN, VALID, WORDS, Checked, CheckedCamera
from camcal.quality.camera_drift import LensDrift, drift_grid
from camcal.quality.projection_uncertainty import ProjectionUncertainty
from camcal.report.figures.differences import lens_drift
from camcal.report.figures.image_plane import projection_uncertainty
from camcal.report.page.record import BAD, GOOD, UNKNOWN, WARNING, Page, PageVerdict, Section, ShownMessage, Table
from camcal.report.page.record import Figure as KeyFigure
from camcal.report.page.thumbnails import pictures

_STATES = {VALID: GOOD, DRIFTED: BAD, NOT_SHOWN: UNKNOWN}
_REMEDIES = {
    VALID: "",
    DRIFTED: "Calibrate again, or undo what has changed.",
    NOT_SHOWN: "Take the images that are named below, and check again.",
}
_HEADS = ("what", "verdict", "drift, px", "± std", "limit, px", "smallest shown, px", "images")


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
