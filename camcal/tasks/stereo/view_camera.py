"""The camera an undistortion starts from, and the camera file of the view it ends with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from camcal import files
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import CamcalError, InvalidInput
from camcal.formats import native, provenance
from camcal.formats.camera_file import CameraEntry, CameraFile, Verdict
from camcal.progress import Progress
from camcal.run.paths import split_address
from camcal.run.pose_sources import read_camera_file

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


def read_source(address: str, name: str | None, progress: Progress) -> SourceCamera:
    """Return the camera of FILE or FILE#NAME; raises InvalidInput if it is not clear which one is meant."""
    path, addressed = split_address(address)
    file = read_camera_file(path, progress)
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
