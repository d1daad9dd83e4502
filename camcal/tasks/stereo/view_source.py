"""What `camcal view` shows: a point cloud as its file has it, or the points of a disparity map whose pair is known."""

from pathlib import Path

import numpy as np

from camcal.errors import InvalidInput
from camcal.files import read_bytes
from camcal.formats import disparity, pointclouds
from camcal.formats.disparity import DisparityMap
from camcal.formats.disparity_sidecar import Sidecar
from camcal.geometry.axes import rotation_of
from camcal.images.npy import names_in
from camcal.progress import Progress
from camcal.run.fanout import over_threads
from camcal.stereo.points.cloud import CloudMaker
from camcal.stereo.points.frames import WORDS, Frame
from camcal.stereo.points.selection import Selection, select
from camcal.stereo.points.vertices import VertexStream
from camcal.tasks.stereo.map_sources import named_file, stereo_image
from camcal.tasks.stereo.options import GeometryOptions
from camcal.tasks.stereo.rectified_pair import pair_of

_POINTS = "points"  # what the archive of a cloud holds
_CAMERA = "x right, y down, z forward"
_UPRIGHT = "x east, y north, z up"
_EXAMPLE = "x forward, y left, z up"
_AXES = {name: words.partition(": ")[2] for name, words in WORDS.items()}  # whose they are, the name does not say


def is_cloud(path: Path) -> bool:
    """Return whether a file is a point cloud by its suffix; NumPy archives can be either, and are looked into.

    Raises InvalidInput for a suffix that neither clouds nor disparity maps have, FileError for an archive that cannot
    be read.
    """
    suffix = path.suffix.lower()
    if suffix not in (*pointclouds.SUFFIXES, *disparity.SUFFIXES):
        known = " ".join(dict.fromkeys((*pointclouds.SUFFIXES, *disparity.SUFFIXES)))
        raise InvalidInput(f"neither a point cloud nor a disparity map; known are {known}", where=str(path))
    if suffix not in disparity.SUFFIXES:
        return True
    return suffix in pointclouds.SUFFIXES and _POINTS in names_in(read_bytes(path))


def cloud_in(path: Path, frame: str | None = None) -> VertexStream:
    """Return the points of a cloud's file; frame: a name or in words, by default what the file says.

    Raises InvalidInput for words that do not say where x, y and z point, FileError if the file cannot be read.
    """
    words = None if frame is None else _AXES.get(frame, frame)
    if words is not None and not says_axes(words):
        raise InvalidInput(
            f"frame {frame!r} does not say where the axes point; use {', '.join(_AXES)}, or words such as {_EXAMPLE!r}"
        )
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


def says_axes(frame: str) -> bool:
    """Return whether words say where x, y and z point."""
    return _CAMERA in frame or not np.array_equal(rotation_of(frame), np.eye(3))


def _usual_frame(path: Path) -> str:
    """Return the frame of files that say nothing of it: laser scans stand upright, others are taken for a camera's."""
    axes = _UPRIGHT if path.suffix.lower() in pointclouds.LASER_SUFFIXES else _CAMERA
    return f"not said, taken for {axes}"


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
