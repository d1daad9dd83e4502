"""Two cameras of a rig file and how they stand: by their names, or the only two."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import InvalidInput
from camcal.formats import cameras
from camcal.formats.camera_file import CameraFile, pose_between
from camcal.formats.cameras.record import Given, MissingSize
from camcal.geometry.pose import JOINT, Pose
from camcal.parsing import did_you_mean
from camcal.progress import SILENT, Progress
from camcal.run.paths import split_address

Size = tuple[int, int]


@dataclass(frozen=True, eq=False)
class GivenRig:
    """Two cameras of a file, in the order of the images, and second_T_first."""

    path: Path
    file: CameraFile
    names: tuple[str, str]
    second_T_first: Pose

    @property
    def cameras(self) -> Mapping[str, Camera]:
        return {name: self.file.cameras[name].camera for name in self.names}

    @property
    def circles(self) -> Mapping[str, ImageCircle | None]:
        return {name: self.file.cameras[name].image_circle for name in self.names}

    def pose(self, target: str, source: str) -> Pose:
        """Return target_T_source of the two."""
        return self.second_T_first if source == self.names[0] != target else self.second_T_first.inverse()


def read_rig(
    address: str,
    wanted: tuple[str, ...] | None,
    size_of_images: Callable[[], Size | None],
    second: Path | None = None,
    model: str | None = None,
    progress: Progress = SILENT,
) -> GivenRig:
    """Return two cameras of a rig file, FILE or FILE#LEFT,RIGHT.

    wanted: their names, in the order of the images; None for the only two. size_of_images: asked where the file says
    none. second: the other file of a rig that is written as two. model: the lens model of four coefficients.
    Raises InvalidInput if it is not clear which two are meant or no transform joins them, and as `cameras.read` does.
    """
    path, named = split_address(address)
    try:
        file = cameras.read(path, progress, Given(None, model), second)
    except MissingSize:
        if (size := size_of_images()) is None:
            raise
        file = cameras.read(path, progress, Given(size, model), second)
    names = _chosen(file, wanted or (tuple(named.split(",")) if named else None), str(path))
    pose = pose_between(file, names[1], names[0])
    if pose is None:
        transform = f"{names[1]}{JOINT}{names[0]}"
        raise InvalidInput(f"no transform joins {names[0]} and {names[1]}: {transform} is missing", where=str(path))
    return GivenRig(path, file, names, pose)


def _chosen(file: CameraFile, wanted: tuple[str, ...] | None, where: str) -> tuple[str, str]:
    known = list(file.cameras)
    for name in wanted or ():
        if name not in known:
            raise InvalidInput(f"no camera {name!r}{did_you_mean(name, known)}", where=where)
    names = known if wanted is None else list(wanted)
    if len(names) != 2:
        several = f"holds {len(known)} cameras ({', '.join(known)})"
        advice = "a pair needs two" if len(known) < 2 else f"name two, such as --cameras {','.join(known[:2])}"
        raise InvalidInput(f"{several}; {advice}", where=where)
    return names[0], names[1]
