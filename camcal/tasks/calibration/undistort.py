"""`camcal undistort`: undistorted images and videos, and their camera file.

With --points, a table of pixels of the distorted image to pixels of the view, and the reverse. With --maps, where the
pixels of the view come from, for other programs to draw it.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, field, replace
from camcal.errors import CamcalError, InvalidInput
from camcal.formats import cameras, native, provenance, split_address
from camcal.formats.camera_file import CalibrationVerdict, CameraEntry, CameraFile, verdict_of_view
from camcal.formats.maps import mesh_nodes, write_maps, write_mesh
from camcal.formats.tables import Table, cell, csv_rows, numbered_lines
from camcal.images.files import KINDS, load, save
from camcal.images.options import PINHOLE
from camcal.images.remap import align_channels, build_maps
from camcal.images.video import frames
from camcal.images.views import make_view
from camcal.messages import Message
from camcal.options import command_line
from camcal.progress import SILENT, Outcome, Progress, reused, warn_of
from camcal.run import fingerprint
from camcal.run.outputs import claim, writes
from camcal.run.paths import Media, find_media, names_file, refuse_collisions, require_one
from camcal.tasks.calibration.drawing import Drawing, Drawn, Sources, require_success, same_shape
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.given_camera import outside_region, read_camera_file, require_no_image, view_outside_region

CAMERA_FILE = "camera.yaml"
MASK_FILE = "valid_mask.png"
_OTHERWISE = {".pfm": ".tiff"}  # of the types that are read and not written; all others become PNG
_FRAME_SUFFIX = ".jpg"
_SHRUNK = 0.25  # of the size it had: below that, the middle of an image is worth a warning
_PIXEL = ("u", "v")
_DIGITS = 12

MESH_SUFFIX = ".txt"


@dataclass(frozen=True, eq=False)
class SourceCamera:
    """A camera of a file, its name there, the lenses of single colours and what else is known of it.

    path: None for a camera that the command line gives.
    """

    path: Path | None
    name: str
    camera: Camera
    channels: Mapping[str, Camera] = field(default_factory=dict)
    circle: ImageCircle | None = None
    verdict: CalibrationVerdict | None = None

    @property
    def files(self) -> list[Path]:
        """The camera file, if there is one."""
        return [] if self.path is None else [self.path]

    @property
    def origin(self) -> dict[str, str]:
        """Where the camera comes from, for the provenance of what is made with it."""
        if self.path is None:
            return {"name": self.name, "given_by": "--camera-matrix"}
        return {"file": self.path.as_posix(), "name": self.name, "sha256": fingerprint.of_source(self.path)}


@dataclass(frozen=True, eq=False)
class UndistortReport:
    """The camera of the view, what became of every image, and what was written beside the images.

    valid: share of the view's pixels that have a source. aligned: the colours that a colour image is aligned in.
    """

    view: Camera
    outcomes: tuple[Outcome[Path, Drawn], ...]
    camera_file: Path
    mask_file: Path | None
    valid: float
    aligned: tuple[str, ...] = ()

    @property
    def failed(self) -> tuple[Outcome[Path, Drawn], ...]:
        return tuple(outcome for outcome in self.outcomes if outcome.error is not None)


@writes
def undistort(options: UndistortOptions, progress: Progress = SILENT) -> UndistortReport:
    """Return what became of every image after writing what can be written to options.output.

    Raises InvalidInput for a view the camera cannot give, or an output that would replace an input; FileError; and
    the first image's error when there is none that could be written.
    """
    if options.camera_file is not None:
        require_no_image(split_address(options.camera_file)[0])
    media = find_media(options.images, recursive=options.recursive)
    source = read_source(options, partial(_first_size, media), progress)
    outputs, camera_file, mask_file = _places(options, media)
    claim([*outputs.values(), camera_file, *([mask_file] if options.mask else [])])
    if options.scale_intrinsics:
        source = _rescale(source, media)
    view = make_view(source.camera, options.view, source.circle)
    share = view.value("fx") / view.image_size[0] * source.camera.image_size[0] / source.camera.value("fx")
    if view.model.name == PINHOLE and share < _SHRUNK:
        text = f"scale at the image centre {100 * share:.0f} %: use --projection cylinder or a smaller --fov"
        progress.warn(Message("reduced_scale", text, {"scale": share}))
    warn_of(view_outside_region(source.verdict, source.camera, view), progress)
    maps = build_maps(source.camera, view, options.interpolation, circle=source.circle)
    lenses = source.channels if options.align_channels else {}
    maps = align_channels(maps, lenses, view) if lenses else maps
    advice = ": if it was resized, not cropped, give --scale-intrinsics"
    drawing = Drawing({source.name: maps}, options.border, options.quality, advice)
    suffix = f".{options.format}" if options.format else _FRAME_SUFFIX
    videos = {video: options.output / f"{video.stem}{suffix}" for video in media.videos}
    sources = {source.name: Sources(outputs, videos)}
    outcomes = tuple(outcome for _, outcome in drawing.outcomes(sources, options.jobs, options.batch, progress))
    require_success(outcomes)
    if options.mask:
        save(mask_file, np.where(maps.valid(), 255, 0).astype(np.uint8))
    write_view(camera_file, source, view, command_line("undistort", options), progress, tuple(lenses))
    return UndistortReport(
        view,
        outcomes,
        camera_file,
        mask_file if options.mask else None,
        float(maps.valid().mean()),
        tuple(lenses),
    )


def _places(options: UndistortOptions, media: Media) -> tuple[dict[Path, Path], Path, Path]:
    """Return the file for each image, that of the camera and that of the mask: in a folder, or beside the only image.

    Raises InvalidInput if several images would go into one file.
    """
    output = options.output
    if not names_file(output, tuple(KINDS)):
        outputs = {path: output / f"{path.stem}{suffix_of(path, options.format)}" for path in media.images}
        refuse_collisions(outputs)
        return outputs, output / CAMERA_FILE, output / MASK_FILE
    if media.videos:
        raise InvalidInput("frames of a video do not go into one file; give a folder", where=str(output))
    require_one(output, len(media.images))
    if options.format is not None and KINDS[output.suffix.lower()] != KINDS[f".{options.format}"]:
        raise InvalidInput(f"--format {options.format} is another type of file; leave it out", where=str(output))
    return {media.images[0]: output}, output.with_suffix(f".{CAMERA_FILE}"), output.with_suffix(f".{MASK_FILE}")


def suffix_of(source: Path, kind: str | None) -> str:
    """Return the suffix of the image that is written for a source: that of the format asked for, or its own."""
    if kind is not None:
        return f".{kind}"
    suffix = source.suffix.lower()
    return source.suffix if suffix in KINDS else _OTHERWISE.get(suffix, ".png")


def _rescale(source: SourceCamera, media: Media) -> SourceCamera:
    """Return the camera, its channels and its image circle for images of the size of the first one that can be read."""
    size, usual = _first_size(media), source.camera.image_size
    if size is None or size == usual:
        return source
    if not same_shape(size, usual):
        found, wanted = ("{}x{}".format(*each) for each in (size, usual))
        raise InvalidInput(f"images of {found} are not resized images of {wanted}: they need a camera of their own")
    scale = size[0] / usual[0], size[1] / usual[1]

    def resized(camera: Camera) -> Camera:
        return Camera(camera.model, size, camera.model.rescale(camera.parameters, scale, (0.0, 0.0)))

    channels = {colour: resized(lens) for colour, lens in source.channels.items()}
    circle = None if source.circle is None else source.circle.resized(size)
    verdict = verdict_of_view(source.verdict)
    return replace(source, camera=resized(source.camera), channels=channels, circle=circle, verdict=verdict)


def _first_size(media: Media) -> tuple[int, int] | None:
    for path in (*media.images, *media.videos):
        try:
            return next(frames(path)).size if path in media.videos else load(path).size
        except CamcalError:
            continue  # it is reported when its turn comes
    return None


def document(report: UndistortReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    view = report.view
    aligned = {"aligned_channels": list(report.aligned)} if report.aligned else {}
    return {
        "camera_file": report.camera_file,
        "mask": report.mask_file,
        "view": {
            "model": view.model.name,
            "image_size": view.image_size,
            "parameters": {name: view.value(name) for name in view.model.parameter_names},
            "valid": report.valid,
        },
        "images": [
            {"source": outcome.item, "frame": drawn.frame, "output": drawn.output, "orientation": drawn.orientation}
            for outcome in report.outcomes
            if (drawn := outcome.value) is not None
        ],
        "reused": reused(report.outcomes),
        "failed": [{"source": outcome.item, "message": str(outcome.error)} for outcome in report.failed],
        **aligned,
    }


def read_source(
    options: UndistortOptions, size_of_images: Callable[[], tuple[int, int] | None], progress: Progress
) -> SourceCamera:
    """Return the camera that is meant; raises InvalidInput if that is not clear, and as `read_camera_file` does."""
    path, addressed = (None, None) if options.camera_file is None else split_address(options.camera_file)
    file = read_camera_file(options.camera_file, options.given, progress, size_of_images, central=False)
    wanted = options.camera_name or addressed
    entry = cameras.select(file, wanted, str(path or "--camera-matrix"))
    name = cameras.name_in(file, wanted)
    return SourceCamera(path, name, entry.camera, entry.channels, entry.image_circle, entry.verdict)


def write_view(
    path: Path,
    source: SourceCamera,
    view: Camera,
    arguments: Sequence[str],
    progress: Progress,
    aligned: Sequence[str] = (),
) -> None:
    """Write the camera of a view, with the verdict on the lens; a warning is given if it replaces that of another view.

    aligned: the colours that were drawn through a lens of their own.
    """
    before = _earlier(path)
    block = (
        provenance.build(arguments, None)
        | {"camera": source.origin}
        | ({"aligned_channels": list(aligned)} if aligned else {})
    )
    native.write(
        path, CameraFile({source.name: CameraEntry(view, verdict=verdict_of_view(source.verdict))}, provenance=block)
    )
    if before is not None and not _same(before, view):
        text = "replaces the camera file of another view: images undistorted earlier no longer match it"
        progress.warn(Message("replaced_view", text, where=str(path)))


def _earlier(path: Path) -> Camera | None:
    """Return the camera of an earlier view in the same place, None if there is none."""
    try:
        with files.unwatched():
            return next(iter(native.read(path).cameras.values())).camera
    except CamcalError:
        return None


def _same(one: Camera, other: Camera) -> bool:
    same_kind = one.model == other.model and one.image_size == other.image_size
    # 12 digits are written
    return same_kind and np.allclose(one.parameters, other.parameters, rtol=1e-10, atol=1e-10)


@dataclass(frozen=True, eq=False)
class PointsReport:
    """What was written: moved points, and how many of them have no place on the other side.

    camera_file: the camera of the view, None for the way back.
    """

    output: Path
    camera_file: Path | None
    count: int
    lost: int


@writes
def undistort_points(options: UndistortOptions, progress: Progress = SILENT) -> PointsReport:
    """Return what was written to options.output: the table with other u and v, empty where a point has no place.

    Raises InvalidInput for a table without u and v, or with something else than numbers in them; FileError.
    """
    if options.points is None:
        raise InvalidInput("no points: give a table with --points")
    source = read_source(options, lambda: options.view.size, progress)
    output = options.output
    if not output.suffix and not files.is_stream(output):
        output /= options.points.name  # in a folder, under the same name
    camera_file = None if options.distort or files.is_stream(output) else output.with_suffix(".camera.yaml")
    claim([output] if camera_file is None else [output, camera_file])
    view = make_view(source.camera, options.view, source.circle)
    table = _read_points(options.points)
    pixels = np.column_stack([table.numbers_or_empty(name) for name in _PIXEL])
    if options.distort:
        moved = _lit(move_pixels(view, source.camera, pixels), source.circle)
    else:
        moved = move_pixels(source.camera, view, _lit(pixels, source.circle))
    distorted = moved if options.distort else pixels
    known = distorted[np.isfinite(distorted).all(axis=1)]
    warn_of(outside_region(source.verdict, known, "the points", "calibrate with corners there"), progress)
    files.write_text(output, _points_text(table, moved))
    if camera_file is not None:
        write_view(camera_file, source, view, command_line("undistort", options), progress)
    return PointsReport(output, camera_file, len(moved), int(np.isnan(moved[:, 0]).sum()))


def move_pixels(source: Camera, target: Camera, pixels: Array) -> Array:
    """Return the pixels (N, 2) of `target` that look along the rays of pixels (N, 2) of `source`; NaN where none do."""
    return target.project(source.unproject(pixels).at()).pixels


def _lit(pixels: Array, circle: ImageCircle | None) -> Array:
    """Return the pixels (N, 2) with NaN for those outside of the image circle."""
    return pixels if circle is None else np.where(circle.contains(pixels)[:, None], pixels, np.nan)


def _read_points(path: Path) -> Table:
    lines = [(number, line) for number, line in numbered_lines(path) if not line.startswith("#")]
    rows = csv_rows(str(path), lines)
    names = [name.strip() for name in rows[0]] if rows else []
    if any(names.count(name) != 1 for name in _PIXEL):
        raise InvalidInput(f"the first row names the columns, u and v once among them; found {names}", where=str(path))
    if len(set(names)) < len(names):
        raise InvalidInput(f"column {max(names, key=names.count)!r} occurs twice", where=str(path))
    return Table.of_rows(str(path), names, rows[1:], [number for number, _ in lines[1:]])


def _points_text(table: Table, pixels: Array) -> str:
    """Return a table as CSV with other pixels (N, 2); a point without a place has empty cells."""
    columns = dict(table.columns)
    for name, values in zip(_PIXEL, pixels.T, strict=True):
        columns[name] = ["" if np.isnan(value) else f"{value:.{_DIGITS}g}" for value in values]
    rows = [list(columns), *zip(*columns.values(), strict=True)]
    return "".join(",".join(map(cell, row)) + "\n" for row in rows)


def points_document(report: PointsReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {
        "output": report.output,
        "camera_file": report.camera_file,
        "points": report.count,
        "without_place": report.lost,
    }


@dataclass(frozen=True, eq=False)
class MapsReport:
    """What was written, how it is used, and the share of pixels that have a source.

    camera_file: the camera of the view, None for the way back.
    """

    output: Path
    camera_file: Path | None
    usage: str
    view: Camera
    valid: float


@writes
def undistort_maps(options: UndistortOptions, progress: Progress = SILENT) -> MapsReport:
    """Return what was written to options.output: the map of the view, or the way back.

    Raises InvalidInput for a view that the camera cannot give, or that the format cannot hold; FileError.
    """
    source = read_source(options, lambda: options.view.size, progress)
    output = options.output
    camera_file = None if options.distort else output.with_suffix(".camera.yaml")
    claim([output] if camera_file is None else [output, camera_file])
    view = make_view(source.camera, options.view, source.circle)
    lens, drawn = (view, source.camera) if options.distort else (source.camera, view)
    circle = None if options.distort else source.circle
    if output.suffix.lower() == MESH_SUFFIX:
        nodes = mesh_nodes(drawn.image_size, options.mesh_step)
        sources = move_pixels(drawn, lens, nodes.reshape(-1, 2)).reshape(nodes.shape)
        usage = write_mesh(output, nodes, sources, options.mesh_step)
        valid = float(np.mean((sources >= 0) & (sources <= np.array(lens.image_size) - 1)))
    else:
        maps = build_maps(lens, drawn, circle=circle)
        usage, valid = write_maps(output, maps), float(np.mean(maps.valid()))
    if camera_file is not None:
        write_view(camera_file, source, view, command_line("undistort", options), progress)
    return MapsReport(output, camera_file, usage, view, valid)


def maps_document(report: MapsReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {"output": report.output, "camera_file": report.camera_file, "usage": report.usage, "valid": report.valid}
