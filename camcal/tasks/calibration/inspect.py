"""`camcal inspect`: contents of a camera file, as text or single values."""

import math
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from camcal.cameras.model import Camera
from camcal.cameras.validity import field_of_view, field_size
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.formats import cameras, documents, emit, native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.provenance import image_counts
from camcal.parsing import did_you_mean
from camcal.report.table import held_by_prior_words, length_unit, projection_words, value_and_std
from camcal.run.outputs import writes
from camcal.targets.board import CLASSES, RATIOS, Surface
from camcal.tasks.file_options import InspectOptions
from camcal.tasks.gates import stated
from camcal.tasks.given_camera import read_part
from camcal.tasks.options import WHOLE, ImagePart
from camcal.tasks.rigs.inspect_rig import RigInspection, draw_rig, inspect_rig
from camcal.tasks.rigs.inspect_rig import as_data as rig_data

if TYPE_CHECKING:
    from camcal.tasks.calibration.errors_at_range import RangeErrors


@dataclass(frozen=True, eq=False)
class Inspection:
    """A camera file: the records it makes, the cameras that were asked for.

    fields: horizontal, vertical and diagonal field of view of each camera, degrees. rig: what the cameras make
    together, None where they are no rig. errors: of measurements, at the distances that were asked for. part: of the
    images of the file's cameras, that these are for.
    """

    path: Path
    file: CameraFile
    fields: Mapping[str, tuple[float, float, float]]
    rig: RigInspection | None = None
    errors: "tuple[RangeErrors, ...]" = ()
    part: ImagePart = WHOLE

    @cached_property
    def document(self) -> documents.Document:
        """The document as it stands, read only where it is asked for; of another program's file, and of a part of the
        images, what camcal would write of it.
        """
        if self.part == WHOLE and cameras.format_of(self.path).name == cameras.OWN:
            return documents.load(self.path)
        return documents.Document(str(self.path), emit.plain(native.block(self.file, self.path)), {})


@writes
def inspect(options: InspectOptions) -> Inspection:
    """Return what a camera file holds, after drawing the rig to options.output, if that is given.

    Raises InvalidInput or FileError as `cameras.read` does, InvalidInput for a picture of what is no rig, and for
    errors of measurements where no covariance is known.
    """
    path, camera = options.address
    file = read_part(path, options.part, size=options.layout.size, central=False)
    if camera is not None:
        cameras.select(file, camera, str(path))
    names = list(file.cameras) if camera is None else [camera]
    rig = inspect_rig(file, str(path)) if camera is None and options.get is None else None
    if options.output is not None:
        if rig is None:
            raise InvalidInput("no picture: it needs a file of several cameras that transforms join", where=str(path))
        draw_rig(rig, options.output)
    found = Inspection(path, file, {name: _field_deg(file.cameras[name]) for name in names}, rig, part=options.part)
    if not (asked := options.measured).distances:
        return found
    from camcal.tasks.calibration.errors_at_range import errors_of_file  # most inspections do without

    errors = (errors_of_file(file, rig, each, asked.length, camera) for each in asked.distances)
    return replace(found, errors=tuple(errors))


def _field_deg(entry: CameraEntry) -> tuple[float, float, float]:
    horizontal, vertical, diagonal = np.degrees(field_of_view(entry.camera, entry.image_circle)).tolist()
    return horizontal, vertical, diagonal


def value_at(inspection: Inspection, key: str) -> Any:
    """Return what stands under a key path such as cameras.left.intrinsics.fx or cameras.left.fixed[0].

    Raises InvalidInput that names the nearest key.
    """
    value: Any = inspection.document.data
    path = ""
    for part in key.replace("[", ".[").split("."):
        known = _parts(value)
        if part not in known:
            what = f"no key {part!r} under {path}" if path else f"no key {part!r}"
            raise InvalidInput(f"{what}{did_you_mean(part, list(known))}", where=inspection.document.where)
        value = known[part]
        path = f"{path}.{part}" if path else part
    return value


def _parts(value: Any) -> dict[str, Any]:
    if isinstance(value, list):
        return {f"[{index}]": item for index, item in enumerate(value)}
    return value if isinstance(value, dict) else {}


def parameter_rows(camera: Camera) -> list[list[str]]:
    """Return name, value and standard deviation of every parameter as text."""
    rows = []
    for name in camera.listed:
        value, std = value_and_std(camera.value(name), camera.std(name))
        rows.append([name, value, "fixed" if name in camera.fixed else std])
    return rows


def camera_lines(entry: CameraEntry, field_deg: tuple[float, float, float]) -> Iterator[str]:
    """Yield what is known of one camera beside its parameters, a line each."""
    names = "horizontal", "vertical", "diagonal"
    known = [f"{name} {angle:.1f}°" for name, angle in zip(names, field_deg, strict=True) if math.isfinite(angle)]
    if not entry.camera.model.is_central:
        known = [
            "{:.4g} x {:.4g} mm".format(*(1e3 * side for side in field_size(entry.camera, 1.0, entry.image_circle)))
        ]
    yield "field of view " + (", ".join(known) or "unknown: the lens model is not valid at the edges of the image")
    if entry.valid is not None:
        yield "valid " + (", ".join(_valid_words(entry)) or "everywhere")
    if entry.image_circle is not None:
        yield entry.image_circle.words
    if entry.held_by_prior:
        yield held_by_prior_words(entry.held_by_prior)
    if entry.quality:
        yield "fit " + _figures(entry.quality)
    if entry.noise is not None:
        dof = entry.noise.degrees_of_freedom
        yield f"noise {entry.noise.sigma_px:.3g} px" + (f" ({dof} degrees of freedom)" if dof else "")
    for item in entry.projection:
        yield projection_words(item.figures, item.range_m)
    if entry.sensor:
        yield "sensor " + _figures(entry.sensor)
    if entry.channels:
        yield f"separate lens models for {', '.join(entry.channels)}"


def _valid_words(entry: CameraEntry) -> Iterator[str]:
    valid = entry.valid
    if valid is not None and valid.max_theta is not None:
        yield f"up to {math.degrees(valid.max_theta):.1f}° from the axis"
    if valid is not None and valid.max_radius_px is not None:
        yield f"up to {valid.max_radius_px:.0f} px from the principal point"
    if valid is not None and valid.polygon is not None:
        yield f"inside a polygon of {len(valid.polygon)} corners"


def _figures(figures: Mapping[str, float]) -> str:
    """Return named numbers as words: rms_px: 0.214 becomes 'rms 0.214 px'."""
    units = ("px", "um", "e", "dn")
    words = []
    for key, value in figures.items():
        name, _, unit = key.rpartition("_")
        text = f"{value:.3g}" if isinstance(value, float) else str(value)
        words.append(f"{name.replace('_', ' ')} {text} {unit}" if unit in units else f"{key.replace('_', ' ')} {text}")
    return ", ".join(words)


def file_lines(file: CameraFile, *, verbose: bool = True) -> Iterator[str]:
    """Yield what a file holds beside its cameras, a line each; verbose: the terms of the board's shape too."""
    yield from transform_lines(file)
    if file.board_shape is not None:
        yield from _board_lines(file.board_shape, verbose=verbose)
    if source := file.converted_from:
        yield f"converted from {source['file']} ({source['format']})"
    provenance = file.provenance
    if "tool" in provenance:
        yield f"made by {provenance['tool']} {provenance.get('tool_version', '')}".rstrip()
    if "command" in provenance:
        yield f"with {provenance['command']}"
    used, count = image_counts(provenance)
    if count:
        yield f"from {used} of {count} images"


def transform_lines(file: CameraFile) -> Iterator[str]:
    """Yield how far apart the cameras of a file are, a line for each transform."""
    for name, transform in file.transforms.items():
        distance = float(np.linalg.norm(transform.pose.translation))
        angle = math.degrees(float(np.linalg.norm(transform.pose.vector())))
        yield f"{name}: {distance:.6g} m apart, rotated by {angle:.3f}°"


def _board_lines(surface: Surface, *, verbose: bool) -> Iterator[str]:
    factor, unit = length_unit(surface.board)
    bend, std = value_and_std(factor * surface.deflection, factor * surface.deflection_std)
    yield f"board {surface.board.words}, bent by {bend} ± {std} {unit} peak to peak"
    if not verbose:
        return
    for term, value, spread in zip(surface.terms, surface.coefficients, surface.coefficients_std(), strict=True):
        scale, what = (100.0, "%") if term in RATIOS else (factor, unit)
        shown, sigma = value_and_std(scale * float(value), scale * float(spread))
        yield f"board {term}: {shown} ± {sigma} {what}"
    for name, (value, spread) in surface.classes.items():
        shown, sigma = value_and_std(100 * value, 100 * spread)
        ratio = name in CLASSES and set(CLASSES[name].terms) <= set(RATIOS)
        whole = "" if ratio else " of the longer side"
        yield f"board, scale of {name}: {shown} ± {sigma} %{whole}"
    if surface.offsets is not None:
        yield f"board points displaced by up to {factor * np.abs(surface.offsets).max():.3g} {unit}"


def image_rows(file: CameraFile) -> list[list[str]]:
    """Return file, points, RMS and, if it was not used, the reason of every image the provenance lists, as text."""
    rows, images = [], file.provenance.get("images")
    for image in images if isinstance(images, list) else []:
        rms = f"{image['rms_px']:.3f}" if "rms_px" in image else ""
        reason = "" if image.get("used", True) else image.get("reason", "not used")
        rows.append([image["file"], str(image.get("points", "")), rms, reason])
    return rows


def _errors_data(errors: "tuple[RangeErrors, ...]") -> list[dict[str, Any]]:
    if not errors:
        return []
    from camcal.tasks.calibration.errors_at_range import as_data

    return [as_data(each) for each in errors]


def document(inspection: Inspection) -> dict[str, Any]:
    """Return the inspection as plain data for --json: the file as it stands, and what follows from it."""
    return {
        "file": inspection.document.where,
        "content": inspection.document.data,
        "stated": {name: stated(inspection.file.cameras[name]) for name in inspection.fields},
        "field_of_view_deg": {name: list(angles) for name, angles in inspection.fields.items()},
        "rig": rig_data(inspection.rig),
        "errors": _errors_data(inspection.errors),
    }
