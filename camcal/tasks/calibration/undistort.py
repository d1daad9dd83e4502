"""`camcal undistort`: images and videos to straight lines, and the camera file that fits what was written."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import CamcalError, InvalidInput
from camcal.formats import native, provenance
from camcal.formats.camera_file import CameraEntry, CameraFile, Verdict
from camcal.images.load import load
from camcal.images.options import PINHOLE
from camcal.images.remap import align_channels, build_maps
from camcal.images.save import KINDS, save
from camcal.images.video import frames
from camcal.images.views import make_view
from camcal.options import command_line
from camcal.progress import SILENT, Outcome, Progress
from camcal.run.paths import (
    Media,
    find_media,
    record_outputs,
    recorded,
    refuse_collisions,
    refuse_overwriting,
    split_address,
)
from camcal.tasks.calibration.drawing import Drawing, Drawn, require_success, same_shape
from camcal.tasks.calibration.options import UndistortOptions

_COMMAND = "camcal undistort"


@dataclass(frozen=True, eq=False)
class SourceCamera:
    """A camera of a file, its name there, the lenses of single colours and what else is known of it."""

    path: Path
    name: str
    camera: Camera
    channels: Mapping[str, Camera] = field(default_factory=dict)
    circle: ImageCircle | None = None
    verdict: Verdict | None = None


CAMERA_FILE = "camera.yaml"
MASK_FILE = "valid_mask.png"

_OTHERWISE = {".pfm": ".tiff"}  # of the types that are read and not written; all others become PNG
_FRAME_SUFFIX = ".jpg"
_SHRUNK = 0.25  # of the size it had: below that, the middle of an image is worth a warning


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


def undistort(options: UndistortOptions, progress: Progress = SILENT) -> UndistortReport:
    """Return what became of every image after writing what can be written to options.output.

    Raises InvalidInput for a view the camera cannot give, or an output that would replace an input; FileError; and
    the first image's error when there is none that could be written.
    """
    source = read_source(options.camera, options.camera_name, progress)
    media = find_media(options.inputs, recursive=options.recursive)
    outputs = {path: options.output / f"{path.stem}{_suffix(path, options.format)}" for path in media.images}
    camera_file, mask_file = options.output / CAMERA_FILE, options.output / MASK_FILE
    refuse_collisions(outputs)
    refuse_overwriting([*outputs.values(), camera_file, mask_file], [source.path, *media.images])
    require_own(camera_file)
    if options.rescale:
        source = _rescaled(source, media)
    view = make_view(source.camera, options.view, source.circle)
    _warn_of_shrinking(source.camera, view, progress)
    maps = build_maps(source.camera, view, options.interpolation, circle=source.circle)
    lenses = source.channels if options.align_channels else {}
    maps = align_channels(maps, lenses, view) if lenses else maps
    advice = ": if it was resized, not cropped, give --rescale"
    drawing = Drawing(maps, options.border, options.quality, advice)
    names = [*(output.name for output in outputs.values()), *([MASK_FILE] if options.mask else [])]
    with recorded(options.output, names):
        outcomes = tuple(_drawn(drawing, outputs, media, options, progress))
        require_success(outcomes)
        if options.mask:
            save(mask_file, np.where(maps.valid(), 255, 0).astype(np.uint8))
        write_view(camera_file, source, view, command_line("undistort", options), progress, tuple(lenses))
    record_outputs(options.output, [outcome.value.output.name for outcome in outcomes if outcome.value])
    return UndistortReport(
        view,
        outcomes,
        camera_file,
        mask_file if options.mask else None,
        float(maps.valid().mean()),
        tuple(lenses),
    )


def _drawn(
    drawing: Drawing, outputs: Mapping[Path, Path], media: Media, options: UndistortOptions, progress: Progress
) -> Iterator[Outcome[Path, Drawn]]:
    """Yield what became of every image and every frame."""
    if outputs:
        yield from drawing.images(outputs, options.jobs, progress)
    suffix = f".{options.format}" if options.format else _FRAME_SUFFIX
    for video in media.videos:
        yield from drawing.video(video, options.output / f"{video.stem}{suffix}", options.jobs, progress)


def _suffix(source: Path, kind: str | None) -> str:
    if kind is not None:
        return f".{kind}"
    suffix = source.suffix.lower()
    return source.suffix if suffix in KINDS else _OTHERWISE.get(suffix, ".png")


def _rescaled(source: SourceCamera, media: Media) -> SourceCamera:
    """Return the camera, its channels and its image circle for images of the size of the first one that can be read."""
    size, usual = _first_size(media), source.camera.image_size
    if size is None or size == usual:
        return source
    if not same_shape(size, usual):
        found, wanted = ("{}x{}".format(*each) for each in (size, usual))
        raise InvalidInput(f"images of {found} are no resized images of {wanted}: they need a camera of their own")
    scale = size[0] / usual[0], size[1] / usual[1]

    def resized(camera: Camera) -> Camera:
        return Camera(camera.model, size, camera.model.rescale(camera.parameters, scale, (0.0, 0.0)))

    channels = {colour: resized(lens) for colour, lens in source.channels.items()}
    circle = None if source.circle is None else source.circle.resized(size)
    return replace(source, camera=resized(source.camera), channels=channels, circle=circle)


def _first_size(media: Media) -> tuple[int, int] | None:
    for path in (*media.images, *media.videos):
        try:
            return next(frames(path)).size if path in media.videos else load(path).size
        except CamcalError:
            continue  # it is reported when its turn comes
    return None


def _warn_of_shrinking(camera: Camera, view: Camera, progress: Progress) -> None:
    share = view.value("fx") / view.image_size[0] * camera.image_size[0] / camera.value("fx")
    if view.model.name == PINHOLE and share < _SHRUNK:
        progress.warn(
            f"the middle of the image shrinks to {100 * share:.0f} % in a pinhole this wide; "
            "--projection cylinder, or a smaller --fov, keeps more of it"
        )


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
        "failed": [{"source": outcome.item, "message": str(outcome.error)} for outcome in report.failed],
        **aligned,
    }


def read_source(address: str, name: str | None, progress: Progress) -> SourceCamera:
    """Return the camera of FILE or FILE#NAME; raises InvalidInput if it is not clear which one is meant."""
    path, addressed = split_address(address)
    file = native.read(path, progress)
    wanted = name or addressed
    entry = native.select(file, wanted, str(path))
    return SourceCamera(
        path, wanted or next(iter(file.cameras)), entry.camera, entry.channels, entry.image_circle, entry.verdict
    )


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
    origin = {"camera": {"file": source.path.as_posix(), "name": source.name, "sha256": files.sha256(source.path)}}
    block = provenance.build(arguments, None) | origin | ({"aligned_channels": list(aligned)} if aligned else {})
    native.write(path, CameraFile({source.name: CameraEntry(view, verdict=source.verdict)}, provenance=block))
    if before is not None and not _same(before, view):
        progress.warn(f"{path}: replaces the camera of another view; images of that one no longer fit it")


def require_own(path: Path) -> None:
    """Raise InvalidInput if there is a file of that name which no undistortion wrote."""
    if not path.exists():
        return
    try:
        command = str(native.read(path).provenance.get("command", ""))
    except CamcalError:
        command = ""
    if not command.startswith(_COMMAND):
        raise InvalidInput("was not written by 'camcal undistort' and is kept; choose another output", where=str(path))


def _earlier(path: Path) -> Camera | None:
    """Return the camera of an earlier view in the same place."""
    return next(iter(native.read(path).cameras.values())).camera if path.exists() else None


def _same(one: Camera, other: Camera) -> bool:
    same_kind = one.model == other.model and one.image_size == other.image_size
    # 12 digits are written
    return same_kind and np.allclose(one.parameters, other.parameters, rtol=1e-10, atol=1e-10)
