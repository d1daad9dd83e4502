"""`camcal view`: a point cloud, or the disparity map of a pair, as a page, a picture, a video or a recording.

What draws with matplotlib is imported where it is used: a page is written before that would be loaded.
A point cloud is shown as its file has it, of a disparity map the points if its pair is known.
"""

from collections.abc import Mapping
from math import pi, radians
from pathlib import Path
from types import MappingProxyType

import numpy as np

from camcal import files
from camcal.dataclass import dataclass
from camcal.errors import InsufficientData, InvalidInput
from camcal.files import read_bytes
from camcal.formats import disparity, pointclouds
from camcal.formats.disparity import DisparityMap
from camcal.formats.disparity_sidecar import Sidecar
from camcal.geometry.pose import rotation_of
from camcal.images.files import save
from camcal.images.image import names_in
from camcal.progress import SILENT, Progress
from camcal.report import cloud_view
from camcal.report.cloud_scene import CloudScene, gather, turn, view_of
from camcal.report.cloud_view import Start
from camcal.report.colour_scale import Paint, paint_of
from camcal.run.outputs import writes
from camcal.run.paths import require_there
from camcal.run.process import over_threads
from camcal.stereo.cloud import CloudMaker
from camcal.stereo.depth import WORDS, Frame, VertexStream
from camcal.stereo.selection import Selection, select
from camcal.tasks.stereo.options import KINDS, PAGE, PICTURE, RECORDING, VIDEO, WINDOW, GeometryOptions, ViewOptions
from camcal.tasks.stereo.rectified_pair import named_file, pair_of, stereo_image

# A page is to open at once; pictures gain nothing from more points than there are pixels in a few.
MOST_POINTS: Mapping[str, int] = MappingProxyType(
    {PAGE: 400_000, PICTURE: 4_000_000, VIDEO: 1_000_000, RECORDING: 4_000_000, WINDOW: 4_000_000}
)

_WIDTH = {PICTURE: 1280, VIDEO: 640}
_SWING = 50.0  # degrees; farther aside, what a camera has not seen is most of the picture
_POINTS = "points"  # what the archive of a cloud holds
_CAMERA = "x right, y down, z forward"
_UPRIGHT = "x east, y north, z up"
_EXAMPLE = "x forward, y left, z up"
_AXES = {name: words.partition(": ")[2] for name, words in WORDS.items()}  # whose they are, the name does not say


def kind_of(options: ViewOptions) -> str:
    """Return what is made, one of KINDS or WINDOW. Raises InvalidInput for a suffix that is none, or without any."""
    if options.output is None:
        if options.rerun:
            return WINDOW
        raise InvalidInput(f"no output: set -o with a suffix of {', '.join(KINDS)}")
    kind = KINDS.get(options.output.suffix.lower())
    if kind is None or (options.rerun and kind != RECORDING):
        fitting = ", ".join(suffix for suffix, each in KINDS.items() if each == RECORDING or not options.rerun)
        raise InvalidInput(
            f"{options.output.suffix or 'no suffix'} is not written; use {fitting}", where=str(options.output)
        )
    return kind


@dataclass(frozen=True)
class ViewReport:
    """What was made: one of KINDS or WINDOW, of so many of the points of the source; colour: what they show.

    outside: points left out because they are far from all others. Of a disparity map shown as it is, without a
    geometry, there are no points, no unit and no frame.
    """

    output: Path | None
    kind: str
    colour: str
    points: int = 0
    shown: int = 0
    outside: int = 0
    unit: str | None = None
    frame: str | None = None


@writes
def view(options: ViewOptions, progress: Progress = SILENT) -> ViewReport:
    """Return what was made to look at.

    Raises InvalidInput for what the cloud does not have, a view or an output that is none, Rerun where it is not
    installed; InsufficientData for a cloud without points or a map without a match; FileError.
    """
    kind = kind_of(options)
    _refuse_what_has_no_effect(options)
    if kind in (RECORDING, WINDOW):
        cloud_view.require_rerun()
    source = _source(options, progress)
    if isinstance(source, DisparityMap):
        return _as_map(options, source)
    scene = gather(source, options.max_points or MOST_POINTS[kind])
    paint = paint_of(scene, options.colour)
    _MAKERS[kind](options, scene, paint)
    return ViewReport(
        options.output,
        kind,
        paint.name,
        points=scene.total,
        shown=len(scene.points),
        outside=scene.outside,
        unit=scene.unit,
        frame=scene.frame,
    )


def _source(options: ViewOptions, progress: Progress) -> VertexStream | DisparityMap:
    """Return the points to look at, or the disparity map whose pair is not known."""
    require_there(options.source)
    if is_cloud(options.source):
        if options.image is not None:
            raise InvalidInput("an image gives its colours to a disparity map; a cloud has its own")
        return cloud_in(options.source, options.frame)
    if options.frame is not None:
        raise InvalidInput("a disparity map is in the frame of its camera; --frame is for a cloud")
    found = disparity.read(options.source)
    return cloud_of(options.source, found, options.image, progress) or found


def _refuse_what_has_no_effect(options: ViewOptions) -> None:
    fitting = {
        "--montage": (options.montage, (PICTURE,)),
        "--size": (options.size is not None, (PICTURE, VIDEO)),
        "--turn": (options.turn is not None, (VIDEO,)),
    }
    for name, (given, kinds) in fitting.items():
        if given and kind_of(options) not in kinds:
            raise InvalidInput(f"{name} is for a {' or a '.join(kinds)}, not for a {kind_of(options)}")


def _as_map(options: ViewOptions, found: DisparityMap) -> ViewReport:
    """Write a disparity map without a geometry as the colours of its disparities."""
    if options.output is None or kind_of(options) != PICTURE:
        raise InvalidInput(
            "has no geometry beside it, hence no points: write .png to see the map itself, or make a cloud with "
            "'camcal stereo cloud'",
            where=str(options.source),
        )
    matched = found.matched()
    if not np.isfinite(matched).any():
        raise InsufficientData("the map has no match to look at", where=str(options.source))
    from camcal.report.stereo_pictures import disparity_picture

    save(options.output, disparity_picture(matched))
    return ViewReport(options.output, PICTURE, "disparity")


def _write_page(options: ViewOptions, scene: CloudScene, paint: Paint) -> None:
    assert options.output is not None
    start = Start(paint.name, options.view, options.point_size)
    files.write_text(options.output, cloud_view.page(scene, options.source.name, start))


def _write_picture(options: ViewOptions, scene: CloudScene, paint: Paint) -> None:
    from camcal.report import cloud_pictures

    assert options.output is not None
    size = _size(options, scene)
    if options.montage:
        pixels = cloud_pictures.montage(scene, paint, size, options.point_size)
    else:
        pixels = cloud_pictures.picture(scene, paint, options.view, size, options.point_size)
    save(options.output, pixels[:, :, ::-1])


def _size(options: ViewOptions, scene: CloudScene) -> tuple[int, int]:
    """Return the size of a picture: that of the options, or as high as what is to be seen."""
    if options.size is not None:
        return options.size
    return view_of("side" if options.montage else options.view, scene).size(_WIDTH[kind_of(options)])


def _write_video(options: ViewOptions, scene: CloudScene, paint: Paint) -> None:
    from camcal.report.cloud_pictures import video_frames, write_video

    assert options.output is not None
    angle = radians(options.turn) if options.turn else radians(_SWING) if scene.from_camera else 2 * pi
    views = turn(view_of(options.view, scene), angle, options.frames)
    pictures = video_frames(scene, paint, views, _size(options, scene), options.point_size)
    write_video(options.output, pictures)


def _write_recording(options: ViewOptions, scene: CloudScene, paint: Paint) -> None:
    assert options.output is not None
    cloud_view.save_recording(options.output, scene, paint)


def _open_window(_options: ViewOptions, scene: CloudScene, paint: Paint) -> None:
    cloud_view.open_viewer(scene, paint)


_MAKERS = {
    PAGE: _write_page,
    PICTURE: _write_picture,
    VIDEO: _write_video,
    RECORDING: _write_recording,
    WINDOW: _open_window,
}


def is_cloud(path: Path) -> bool:
    """Return whether a file is a point cloud by its suffix; NumPy archives can be either, and are looked into.

    Raises InvalidInput for a suffix that neither clouds nor disparity maps have, FileError for an archive that cannot
    be read.
    """
    suffix = path.suffix.lower()
    if suffix not in (*pointclouds.SUFFIXES, *disparity.SUFFIXES):
        known = " ".join(dict.fromkeys((*pointclouds.SUFFIXES, *disparity.SUFFIXES)))
        raise InvalidInput(f"neither a point cloud nor a disparity map; use one of {known}", where=str(path))
    if suffix not in disparity.SUFFIXES:
        return True
    return suffix in pointclouds.SUFFIXES and _POINTS in names_in(read_bytes(path))


def cloud_in(path: Path, frame: str | None = None) -> VertexStream:
    """Return the points of a cloud's file; frame: a name or in words, by default what the file says.

    Raises InvalidInput for words that do not say where x, y and z point, FileError if the file cannot be read.
    """
    words = None if frame is None else _AXES.get(frame, frame)
    if words is not None and not states_axes(words):
        raise InvalidInput(f"unknown axes of frame {frame!r}; use {', '.join(_AXES)}, or words such as {_EXAMPLE!r}")
    found = pointclouds.read(path)
    frame = words or found.frame or _usual_frame(path)
    if "origin" in found.notes:
        frame += f"; coordinates from {found.notes['origin']}"
    return VertexStream(
        count=len(found.vertices),
        type=found.vertices.dtype,
        blocks=(found.vertices,),
        unit=found.unit,
        frame=frame,
        notes=dict(found.notes),
        grid=found.grid,
    )


def states_axes(frame: str) -> bool:
    """Return whether words say where x, y and z point."""
    return _CAMERA in frame or not np.array_equal(rotation_of(frame), np.eye(3))


def _usual_frame(path: Path) -> str:
    """Return the frame of files that say nothing of it: laser scans stand upright, others are taken for a camera's."""
    axes = _UPRIGHT if path.suffix.lower() in pointclouds.LASER_SUFFIXES else _CAMERA
    return f"not stated, {axes} assumed"


def cloud_of(path: Path, found: DisparityMap, image: Path | None, progress: Progress) -> VertexStream | None:
    """Return the points that `camcal stereo cloud` would write for a disparity map; None without a geometry beside it.

    image: the left image, by default the one that the sidecar names.
    Raises InvalidInput if the image has another size, FileError.
    """
    sidecar = found.sidecar or Sidecar()
    height, width = found.values.shape
    pair = pair_of(GeometryOptions(), None, (width, height), sidecar, progress)
    if pair.geometry is None:
        return None
    image = image or named_file(sidecar.image, path, progress)
    sigma = named_file(sidecar.sigma, path, progress)
    stereo = stereo_image(found, pair, image, sigma)
    with over_threads() as each:
        selected = select(stereo, Selection(), Frame(), each)
    return CloudMaker(stereo, selected.kept, sigma=sigma is not None).stream()
