"""The sections of a report on the calibration of a camera, and the report where there is no calibration."""

import re
from collections.abc import Iterator, Mapping, Sequence
from math import degrees, isfinite

import numpy as np

from camcal.calibrate.intrinsics import Calibration, CandidateModel
from camcal.calibrate.view_records import shown_name
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle, field_of_view
from camcal.dataclass import dataclass, field
from camcal.messages import Message, counted
from camcal.quality.assess import Assessment
from camcal.quality.projection_uncertainty import ProjectionUncertainty
from camcal.report.calibration import CANDIDATE_COLUMNS, candidate_rows, parameter_rows, summary
from camcal.report.figures.calibration import calibration_plots
from camcal.report.page.record import (
    DataBlock,
    Figure,
    Page,
    PageVerdict,
    Picture,
    Section,
    Table,
    checks_table,
    refusal,
    sentence,
    verdict,
)
from camcal.report.page.thumbnails import MOST, corner_thumbnail, photo_key, pictures, thumbnails
from camcal.report.table import (
    held_by_prior_words,
    length_unit,
    number_text,
    projection_words,
    region_words,
    value_and_std,
    value_with_std,
)
from camcal.targets.board import RATIOS, Board, Surface
from camcal.targets.detection import BoardDetection

_NOT_IN_IDS = re.compile(r"[^A-Za-z0-9]+")
_STRONG = 0.9  # correlations that are listed


@dataclass(frozen=True, eq=False)
class CalibratedCamera:
    """What a report shows of a camera. candidates: lens models that were compared. photos: by `photo_key`.

    name: "" for a single camera. most: thumbnails at most.
    """

    calibration: Calibration
    uncertainty: ProjectionUncertainty
    assessment: Assessment
    circle: ImageCircle | None = None
    candidates: Sequence[CandidateModel] = ()
    photos: Mapping[str, str] = field(default_factory=dict)
    name: str = ""
    most: int = MOST

    @property
    def prefix(self) -> str:
        """What begins the ids of its elements in the page."""
        return f"{_NOT_IN_IDS.sub('-', self.name)}-" if self.name else ""

    @property
    def owner(self) -> str:
        """What ends the captions of its tables, which differ within a page."""
        return f" of {self.name}" if self.name else ""


def camera_verdict(camera: CalibratedCamera, warnings: Sequence[Message]) -> PageVerdict:
    """Return the verdict in words; warnings: all of the calibration, those of detection too."""
    known = _at_centre_and_corner(camera.uncertainty)[1]
    where = f", {known} at the image corner" if known else ""
    figures = camera.uncertainty.figures()
    inside = figures.get("inside_rms_px", figures.get("rms_px", float("nan")))
    words = f"Projections of far points are uncertain by {_px(inside)} RMS where corners were seen{where} (1 sigma)."
    words = f"The verdict holds{region_words(camera.assessment.region) or ' in the whole image'}. {words}"
    return verdict(camera.assessment.failures, warnings, words)


def key_figures(camera: CalibratedCamera) -> Iterator[Figure]:
    """Yield the figures that are read first."""
    calibration, lens = camera.calibration, camera.calibration.camera
    yield focal_figure(lens)
    yield Figure(
        "Reprojection error (RMS)", _px(calibration.rms_px), f"noise of a coordinate {_px(calibration.sigma_px)}"
    )
    centre, corner = _at_centre_and_corner(camera.uncertainty)
    yield Figure(
        "Projection uncertainty",
        f"{centre or 'unknown'} / {corner or 'unknown'}",
        "image centre / image corner, 1 sigma" + ("" if corner else "; the lens model is not valid at the corner"),
    )
    used, views = len(calibration.used), len(calibration.views)
    yield Figure(
        "Views used", f"{used} of {views}", f"{views - used} without a usable board or rejected" if used < views else ""
    )
    corners, rejected = len(calibration.residuals), len(calibration.rejected)
    yield Figure("Corners used", f"{corners}", f"{rejected} rejected" if rejected else "")
    width, height = lens.image_size
    horizontal, vertical, _ = (degrees(angle) for angle in field_of_view(lens, camera.circle))
    angles = f", field of view {horizontal:.1f}° x {vertical:.1f}°" if isfinite(horizontal + vertical) else ""
    yield Figure("Lens model", lens.model.name, f"{width} x {height} px{angles}")


def focal_figure(camera: Camera, of: str = "") -> Figure:
    """Return the focal lengths; of: what begins the name of the figure, such as 'left: '."""
    focal, other = (value_with_std(camera.value(name), camera.std(name)) for name in ("fx", "fy"))
    return Figure(f"{of}focal length fx" if of else "Focal length fx", f"{focal} px", f"fy {other} px")


def _at_centre_and_corner(uncertainty: ProjectionUncertainty) -> tuple[str, str]:
    """Return the uncertainty at the centre of the image and at that corner where it is largest.

    It is "" where it is not known, and where the lens model is not valid at one of the corners.
    """
    grid = uncertainty.std_rms.reshape(len(uncertainty.v), len(uncertainty.u))
    centre, corner = grid[grid.shape[0] // 2, grid.shape[1] // 2], np.max(grid[[0, 0, -1, -1], [0, -1, 0, -1]])
    at_centre, at_corner = (_px(float(value)) if isfinite(value) else "" for value in (centre, corner))
    return at_centre, at_corner


def _px(value: float) -> str:
    return f"{number_text(value, 3)} px"


def camera_sections(camera: CalibratedCamera, warnings: Sequence[Message] = ()) -> Iterator[Section]:
    """Yield the sections on a camera, from what a reader asks first to details."""
    calibration, prefix = camera.calibration, camera.prefix
    plots = calibration_plots(calibration, camera.uncertainty, camera.candidates, camera.circle)
    found = pictures(plots, prefix)

    def taken(*names: str) -> list[Picture]:
        return [found.pop(name) for name in names if name in found]

    words = projection_words(
        {name.replace("worst", "max"): value for name, value in camera.uncertainty.figures().items()}
    )
    known = ("projection_uncertainty", "coverage", "uncertainty_over_distance")
    yield Section(f"{prefix}uncertainty", "Projection uncertainty and coverage", [f"{words}."], pictures=taken(*known))
    residuals = ("residual_vectors", "residuals_over_radius", "residuals_by_view", "residual_histogram")
    said = [sentence(line) for line in summary(calibration)]
    yield Section(f"{prefix}residuals", "Residuals", said, pictures=taken(*residuals))
    yield board_section(calibration.surface, taken("board_shape", "board_height"), prefix)
    yield Section(f"{prefix}poses", "Poses", pictures=taken("poses"))
    yield images_section(camera)
    yield _parameters(camera, taken("correlations"))
    if camera.candidates:
        caption = "Lens models by how well they predict left-out views"
        table = Table.under(caption, CANDIDATE_COLUMNS, candidate_rows(camera.candidates))
        yield Section(f"{prefix}models", "Choice of the lens model", pictures=taken("lens_models"), tables=[table])
    names = ", ".join(dict.fromkeys(each.code for each in warnings))
    lines = [f"Named: {names}." if names else "No fault was named."]
    yield Section(f"{prefix}checks", "Checks", lines, tables=[checks_table(warnings, camera.owner)])
    if found:
        yield Section(f"{prefix}more", "Further figures", pictures=list(found.values()))


def board_section(surface: Surface, shown: Sequence[Picture], prefix: str = "") -> Section:
    """Return the section on the board: its type, its shape and how well that is known."""
    factor, unit = length_unit(surface.board)
    bend = value_with_std(factor * surface.deflection, factor * surface.deflection_std)
    lines = [f"Board: {surface.board.words}.", f"Deflection {bend} {unit} peak to peak, out of plane."]
    rows = []
    for term, value, std in zip(
        surface.terms, surface.coefficients.tolist(), surface.coefficients_std().tolist(), strict=True
    ):
        scale, what = (100.0, "%") if term in RATIOS else (factor, unit)
        rows.append([term, *value_and_std(scale * value, scale * std), what])
    table = Table.of("Terms of the board's shape", ("term", "value", "± std", "unit"), rows, folded=True)
    if surface.offsets is not None:
        largest = factor * float(np.abs(surface.offsets).max())
        lines.append(f"Per-corner offsets were estimated; the largest is {largest:.2g} {unit}.")
    return Section(f"{prefix}board", "Board shape", lines, pictures=shown, tables=[table] if rows else [])


def images_section(camera: CalibratedCamera) -> Section:
    """Return the section on the images: the worst as thumbnails, all in a table."""
    calibration = camera.calibration
    shown, factor = thumbnails(calibration, camera.photos, camera.name, camera.most)
    more = (
        f"; the other {len(calibration.views) - len(shown)} are in the table"
        if len(shown) < len(calibration.views)
        else ""
    )
    words = (
        f"Blue dots: corners. Yellow lines: residuals, magnified {factor} times. Orange crosses: rejected corners. "
        f"Rejected images first, then by RMS{more}."
    )
    rows = [
        [
            shown_name(view.image),
            "yes" if view.used else "no",
            f"{view.kept or view.points}",
            "" if view.rms_px is None else f"{view.rms_px:.3g}",
            view.reason or "",
        ]
        for view in calibration.views
    ]
    heads = ("image", "used", "corners", "RMS, px", "not used because")
    table = Table.of(f"All images{camera.owner}", heads, rows)
    return Section(f"{camera.prefix}images", "Images", [words], tables=[table], thumbnails=shown)


def _parameters(own: CalibratedCamera, shown: Sequence[Picture]) -> Section:
    calibration, camera = own.calibration, own.calibration.camera
    rows = [
        [name, value, std, ("px" if name in ("fx", "fy", "cx", "cy") else "")]
        for name, value, std in parameter_rows(calibration)
    ]
    tables = [Table.of(f"Lens parameters{own.owner}", ("parameter", "value", "± std", "unit"), rows)]
    names = [name for name in camera.listed if camera.std(name)]
    if camera.covariance is not None and len(names) > 1:
        tables.append(_strongest(own, names))
    lines = [f"Lens model {camera.model.name}."]
    lines += [f"{held_by_prior_words(calibration.held_by_prior)}."] if calibration.held_by_prior else []
    return Section(f"{own.prefix}parameters", "Parameters", lines, pictures=shown, tables=tables)


def _strongest(own: CalibratedCamera, names: Sequence[str]) -> Table:
    """Return the table of strongly correlated parameters, the strongest first."""
    camera = own.calibration.camera
    assert camera.covariance is not None
    index = [camera.model.parameter_names.index(name) for name in names]
    part = camera.covariance[np.ix_(index, index)]
    std = np.sqrt(np.diag(part))
    pairs = [(float(part[i, j] / (std[i] * std[j])), names[i], names[j]) for i in range(len(names)) for j in range(i)]
    strong = sorted((pair for pair in pairs if abs(pair[0]) > _STRONG), key=lambda pair: -abs(pair[0]))
    rows = [[f"{one}, {other}", f"{share:+.3f}"] for share, one, other in strong]
    caption = f"Correlations beyond ± {_STRONG:g}" if rows else f"No correlation is beyond ± {_STRONG:g}"
    return Table.of(f"{caption}{own.owner}", ("parameters", "correlation"), rows, folded=True)


def refused_page(
    title: str,
    board: Board,
    views: Sequence[BoardDetection],
    failure: Message,
    made: str,
    closing: Sequence[Section],
    blocks: Sequence[DataBlock],
    photos: Mapping[str, str],
) -> Page:
    """Return the report; failure: why there is no calibration. closing: the last sections."""
    verdict, shown = refusal(failure)
    detected = [view for view in views if view.found]
    shown_views = [
        corner_thumbnail(each, photos.get(photo_key(each.camera, each.image), "")) for each in detected[:MOST]
    ]
    rows = [[photo_key(view.camera, shown_name(view.image)), f"{len(view.ids)}", view.reason or ""] for view in views]
    table = Table.of("All images", ("image", "corners", "no corners because"), rows)
    lines = ["Blue dots: detected corners. The corner ids of all views have to be those of the board that is given."]
    return Page(
        title,
        f"{counted(len(views), 'image')}, board: {board.words}",
        verdict,
        (shown,),
        figures=tuple(_detection_figures(board, views)),
        sections=(
            Section("images", "Images", lines, thumbnails=shown_views, tables=[table]),
            *closing,
        ),
        made=made,
        blocks=blocks,
    )


def _detection_figures(board: Board, views: Sequence[BoardDetection]) -> list[Figure]:
    found = [view for view in views if view.found]
    corners = sum(len(view.ids) for view in found)
    each = f"median {np.median([len(view.ids) for view in found]):.0f} of {board.count} in a view" if found else ""
    return [
        Figure("Images with the board", f"{len(found)} of {len(views)}"),
        Figure("Corners detected", f"{corners}", each),
    ]
