"""A disparity map and what is known of its pair, or an unrectified pair and its rig, to a point cloud."""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.formats import disparity, disparity_sidecar, pointclouds, pose_text, split_address
from camcal.formats.disparity import DisparityMap
from camcal.formats.disparity_sidecar import Sidecar
from camcal.images.files import load
from camcal.messages import Message
from camcal.parsing import parse_number
from camcal.progress import SILENT, Collected, Progress, values_of, warn_of
from camcal.records import OMITTED, entry
from camcal.run.fanout import fan_out
from camcal.run.paths import IMAGE_SUFFIXES, find_pairs
from camcal.run.process import over_threads
from camcal.stereo.cloud import CloudMaker, require_thinning, thinned
from camcal.stereo.depth import CAMERA, OPTICAL, UNITS, Frame, StereoImage, VertexStream, frame_named
from camcal.stereo.disparity import Confidence, StereoGeometry
from camcal.stereo.selection import RADIUS, Selected, Selection, depth_figures, select
from camcal.tasks.stereo import rectified_pair
from camcal.tasks.stereo.rectified_pair import RectifiedPair, named_file, stereo_image
from camcal.tasks.stereo.rig_pair import (
    Matched,
    PairImages,
    RigPair,
    match_images,
    read_pair,
    require_rectified,
    unrectified_pair,
)
from camcal.tasks.stereo.run_options import CloudOptions, PointOptions, VertexOptions

GRIDS = (".pcd",)  # point clouds that can be organised as an image

_FINEST = 1e-3  # metres; coarser steps than this between float32 coordinates are worth a warning
_NO_GEOMETRY = "unknown geometry: give a camera file of the rectified pair, or --fx, --cx, --cy and --baseline"


@dataclass(frozen=True)
class CloudReport:
    """What was written: points of so many pixels, the scale the disparity was read with, the geometry.

    matched: pixels with a match. outliers: those left out because they stand alone. depth: smallest, median and largest
    z along the optical axis, metres, None for an empty cloud. appearance: colour, gray or none. frame: in words.
    fields: of a point, in the order of the file. calibration_known: whether its uncertainty is part of the depth's.
    warnings: about it, in order. reused: whether an earlier run wrote it.
    """

    output: Path
    points: int
    pixels: int
    matched: int
    outliers: int
    scale: float
    geometry: StereoGeometry
    depth: tuple[float, float, float] | None = field(metadata=entry("depth_m", parts=("min", "median", "max")))
    appearance: str
    frame: str
    unit: str
    fields: tuple[str, ...]
    calibration_known: bool
    warnings: tuple[Message, ...] = field(default=(), metadata=OMITTED)
    reused: bool = False


class PointSource(NamedTuple):
    """The disparities that points are made of, counts of their file per pixel, and the rotation to the real camera."""

    image: StereoImage
    scale: float
    camera_R_rectified: FloatArray | None


def make_cloud(item: tuple[Path, CloudOptions], rig: RigPair | None) -> CloudReport:
    """Return what was written, of a pair rectified by `rig` or of a map, with its warnings.

    The path comes first, as errors have it.
    Raises InvalidInput for a geometry that is incomplete or not rectified, sizes that differ, and for what is asked of
    a point and not known; FileError.
    """
    options, heard = item[1], Collected()
    pointclouds.require_suffix(options.output, ascii_text=options.vertices.ascii_text)
    if options.vertices.organised and options.output.suffix.lower() not in GRIDS:
        raise InvalidInput(f"an organised cloud is written as {' or '.join(GRIDS)}", where=str(options.output))
    report = write_points(options, _source(options, rig, heard), heard)
    return replace(report, warnings=tuple(heard.warnings))


def require_points(points: PointOptions, vertices: VertexOptions) -> None:
    """Raise InvalidInput for options that no cloud is made with, before a pair is matched for one."""
    _selection(replace(points, mask=None))
    _frame(vertices, np.eye(3), SILENT)
    require_thinning(points.voxel, points.max_points)


def write_points(options: CloudOptions, source: PointSource, progress: Progress = SILENT) -> CloudReport:
    """Return what was written of the points of a map to options.output; raises InvalidInput and FileError."""
    image = source.image
    frame = _frame(options.vertices, source.camera_R_rectified, progress)
    with over_threads(options.jobs) as each:
        selected = select(image, _selection(options.points), frame, each)
    if not selected.kept.any():
        progress.warn(Message("empty_cloud", f"empty cloud: {_why_empty(selected)}", where=str(options.disparity)))
    stream = _stream(options, image, selected, frame)
    pointclouds.write(options.output, stream, ascii_text=options.vertices.ascii_text)
    return _report(options, source.scale, image, selected, stream)


def _source(options: CloudOptions, rig: RigPair | None, progress: Progress) -> PointSource:
    """Return the disparities of a map, or of an unrectified pair that is matched for it."""
    image_path, address = _image_and_camera(options.files)
    if rig is not None and image_path is not None:
        images = read_pair((options.disparity, image_path), rig)
        matched = match_images(images, options.matching, jobs=options.jobs)
        warn_of((each.at(images.paths[0]) for each in (*matched.warnings, *matched.failures)), progress)
        return source_of_match(images, matched, options.points.sigma_disparity)
    found = disparity.read(options.disparity, options.scale)
    if image_path is None and found.sidecar:
        image_path = named_file(found.sidecar.image, options.disparity, progress)
    pair = _pair(options, address, found, progress)
    return PointSource(_stereo_image(options, found, pair, image_path, progress), found.scale, pair.camera_R_rectified)


def rig_of_cloud(options: CloudOptions, progress: Progress) -> RigPair | None:
    """Return the cameras that a pair has to be rectified by; None where the options name a disparity map."""
    image, address = _image_and_camera(options.files)
    if address is None or image is None or options.geometry.numbers() or options.scale is not None:
        return None
    if _is_map(options.disparity):
        return None
    known, size_of_images = options.geometry, partial(_size_of_first, options.disparity, image)
    rig = unrectified_pair(address, known.camera, size_of_images, known.given.part)
    if rig is not None:
        warn_of(rig.rectification.warnings, progress)
    return rig


def _is_map(path: Path) -> bool:
    """Return whether a file can only be a disparity map: of a type that images do not have, or with a sidecar."""
    return path.is_file() and (
        path.suffix.lower() not in IMAGE_SUFFIXES or disparity_sidecar.path_beside(path).is_file()
    )


def _size_of_first(left: Path, right: Path) -> tuple[int, int]:
    first = find_pairs([left], [right])[0][0] if left.is_dir() else left
    height, width = load(first).pixels.shape[:2]
    return width, height


def source_of_match(images: PairImages, found: Matched, sigma: float | None = None) -> PointSource:
    """Return the disparities of a pair that was matched; sigma: of all of them, None for what the matcher found.

    Raises InvalidInput if nothing is known of the pair's geometry.
    """
    known, values = images.known, found.disparity
    if known.geometry is None:
        raise InvalidInput(_NO_GEOMETRY)
    image = StereoImage(
        values.values,
        known.geometry,
        signed=True,
        pixels=images.left,
        sigma=values.sigma if sigma is None else sigma,
        confidence=values.confidence,
        calibration=known.calibration_error,
    )
    return PointSource(image, 1.0, known.camera_R_rectified)


def _image_and_camera(files: tuple[str, ...]) -> tuple[Path | None, str | None]:
    cameras = [text for text in files if split_address(text)[0].suffix.lower() in rectified_pair.SUFFIXES]
    images = [Path(text) for text in files if text not in cameras]
    if len(cameras) > 1 or len(images) > 1:
        raise InvalidInput(f"expected one image and one camera file, found {' and '.join(files)}")
    return (images[0] if images else None), (cameras[0] if cameras else None)


def _pair(options: CloudOptions, address: str | None, found: DisparityMap, progress: Progress) -> RectifiedPair:
    height, width = found.values.shape
    if not options.geometry.numbers():
        require_rectified(address, options.geometry.camera, (width, height), options.geometry.given.part)
    pair = rectified_pair.pair_of(options.geometry, address, (width, height), found.sidecar, progress)
    if pair.geometry is None:
        raise InvalidInput(_NO_GEOMETRY)
    return pair


def _stereo_image(
    options: CloudOptions, found: DisparityMap, pair: RectifiedPair, image: Path | None, progress: Progress
) -> StereoImage:
    """Return the map with all that the options make use of."""
    sidecar, points = found.sidecar or Sidecar(), options.points

    def asked(path: Path | None, option: str) -> Path | None:
        return named_file(path, options.disparity, progress, option)

    sigma: Path | float | None = points.sigma_disparity
    if sigma is None and (options.vertices.sigma or points.max_sigma is not None):
        sigma = asked(sidecar.sigma, "--sigma" if options.vertices.sigma else "--max-sigma")
    confidence = None if points.min_confidence is None else asked(sidecar.confidence, "--min-confidence")
    return stereo_image(found, pair, image, sigma, confidence)


def _frame(options: VertexOptions, camera_R_rectified: FloatArray | None, progress: Progress) -> Frame:
    world_T_camera = pose_text.read(options.pose) if options.pose else None
    name = options.frame or (OPTICAL if camera_R_rectified is None else CAMERA)
    frame = frame_named(name, camera_R_rectified, world_T_camera, options.unit)
    step = float(np.spacing(np.abs(frame.frame_T_left.translation).max().astype(np.float32)))
    if step > _FINEST:
        text = f"resolution of coordinates this far from the origin {step:.2g} m: subtract an offset from the pose"
        progress.warn(Message("coarse_coordinates", text, {"step_m": step}))
    return frame


def _selection(options: PointOptions) -> Selection:
    """Return what pixels have to fulfil, from what the user wrote."""
    method, _, radius = options.outliers.partition(":")
    if radius and method != RADIUS:
        raise InvalidInput(f"outliers {options.outliers!r}: only radius takes a number")
    if options.crop is not None and len(options.crop) != 6:
        raise InvalidInput(f"--crop needs six numbers, xmin,xmax,ymin,ymax,zmin,zmax, found {len(options.crop)}")
    return Selection(
        depth=(options.min_depth, options.max_depth),
        crop=None if options.crop is None else np.reshape(options.crop, (3, 2)),
        mask=_mask(options.mask) if options.mask else None,
        max_sigma=options.max_sigma,
        min_confidence=None if options.min_confidence is None else _confidence(options.min_confidence),
        stride=options.stride,
        outliers=method,
        radius=_metres(radius) if radius else None,
    )


def _mask(path: Path) -> Array:
    pixels = load(path).pixels
    return np.asarray(pixels > 0 if pixels.ndim == 2 else (pixels[..., :3] > 0).any(axis=2))


def _confidence(text: str) -> int:
    """Return the number of a class of confidence, given as a number or by its name."""
    names = {member.name.lower(): int(member) for member in Confidence}
    number = names.get(text.lower(), int(text) if text.isdecimal() else -1)
    if number not in names.values():
        classes = ", ".join(f"{value} {name}" for name, value in names.items())
        raise InvalidInput(f"confidence {text!r} is unknown; use one of {classes}")
    return number


def _metres(text: str) -> float:
    try:
        return parse_number(text)
    except ValueError as error:
        raise InvalidInput(f"the radius around a point is a number of metres, found {text!r}") from error


def _why_empty(selected: Selected) -> str:
    if not selected.matched:
        return "no pixel has a match"
    return f"of {selected.matched} pixels with a match none is within the limits"


def _stream(options: CloudOptions, image: StereoImage, selected: Selected, frame: Frame) -> VertexStream:
    points, vertices = options.points, options.vertices
    maker = CloudMaker(
        image, selected.kept, frame, vertices.normals, vertices.sigma, vertices.organised, stride=points.stride
    )
    stream = maker.stream(_notes(options, image), in_order_on_threads(options.jobs))
    voxel = None if points.voxel is None else points.voxel * UNITS[frame.unit]
    return thinned(stream, voxel, points.max_points)


def _notes(options: CloudOptions, image: StereoImage) -> dict[str, str]:
    geometry = image.geometry
    notes = {
        "disparity": options.disparity.name,
        "fx": f"{geometry.fx:.12g} px",
        "baseline": f"{geometry.baseline:.12g} m",
    }
    return notes | ({"doffs": f"{geometry.doffs:.12g} px"} if geometry.doffs else {})


def in_order_on_threads(jobs: int | None) -> Callable[[Callable[[slice], Array], Iterable[slice]], Iterator[Array]]:
    """Return a `map` that works ahead on threads while what it gave is written."""

    def in_order(work: Callable[[slice], Array], items: Iterable[slice]) -> Iterator[Array]:
        for outcome in fan_out(work, items, jobs=jobs):
            yield from values_of([outcome])

    return in_order


def _report(
    options: CloudOptions, scale: float, image: StereoImage, selected: Selected, stream: VertexStream
) -> CloudReport:
    fields = stream.type.names or ()
    appearance = "none" if image.pixels is None else "gray" if image.pixels.ndim == 2 else "colour"
    return CloudReport(
        output=options.output,
        points=int(np.count_nonzero(selected.kept)) if stream.grid else stream.count,
        pixels=image.disparity.size,
        matched=selected.matched,
        outliers=selected.outliers,
        scale=scale,
        geometry=image.geometry,
        depth=depth_figures(image, selected.kept),
        appearance=appearance,
        frame=stream.frame,
        unit=stream.unit,
        fields=tuple(fields),
        calibration_known=image.calibration is not None,
    )
