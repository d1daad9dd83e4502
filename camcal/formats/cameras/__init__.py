"""Camera files of camcal and of other programs: detected by content, read to one record and written from it.

A format is a value of a module, by its name in capitals, and a row of `record`; its module is loaded when a file is of
it, or is to be.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from camcal import files
from camcal.cameras.model import Camera
from camcal.errors import CamcalError, FileError, InvalidInput
from camcal.formats import split_address
from camcal.formats.camera_file import CameraEntry, CameraFile, pose_between
from camcal.formats.cameras.record import (
    ANY_FRAME,
    ROWS,
    CameraFormat,
    Given,
    Row,
    Source,
    name_of,
    name_of_topic,
    named,
    recognise,
)
from camcal.formats.native import implausible
from camcal.geometry.pose import frames_of
from camcal.images.videos import address_of
from camcal.parsing import did_you_mean
from camcal.progress import SILENT, Progress, warn_of

if TYPE_CHECKING:
    from camcal.formats.cameras.nearest import Nearest

OWN = "camcal"

_USUAL = (OWN, "kalibr", "ros", "opencv")  # whose files may have any name; the others' have one that tells them

_SHARED = {  # modules of several formats, or of one with another name
    "camcal_native": "camcal",
    "anipose": "caliscope",
    "kalibr": "openvins",
    "matlab": "bouguet",
    "urdf": "ros_tf",
    "ocamcalib": "vins",
    "datasets": "kitti middlebury euroc",
    "devices": "depthai realsense photonvision",
    "libraries": "boofcv open3d visp",
    "photogrammetry": "metashape nerfstudio opensfm",
}
_MODULES = {name: module for module, names in _SHARED.items() for name in names.split()}


class _Registry(Mapping[str, CameraFormat]):
    """The formats that are read, by name, each loaded when it is asked for."""

    def __init__(self) -> None:
        self.modules = {row.name: _MODULES.get(row.name, row.name) for row in ROWS if row.name}

    def __getitem__(self, name: str) -> CameraFormat:
        module = import_module(f"camcal.formats.cameras.{self.modules[name]}")
        form: CameraFormat = getattr(module, name.upper())
        return form

    def __contains__(self, name: object) -> bool:
        return name in self.modules

    def __iter__(self) -> Iterator[str]:
        return iter(self.modules)

    def __len__(self) -> int:
        return len(self.modules)


FORMATS: Mapping[str, CameraFormat] = _Registry()

_LARGEST = 64 << 20
_LISTED = 12  # cameras that a message names
_NOTHING = Given()


def read(
    path: str | Path, progress: Progress = SILENT, given: Given = _NOTHING, second: Path | None = None
) -> CameraFile:
    """Return the content of a camera file of any format; progress gets warnings of implausible values in it.

    path: FILE, FILE#NAME for one camera of it, BAG#TOPIC of a bag. given: what the user says where the file does not.
    second: the other file of a pair, where it is written as two.
    Raises InvalidInput for every rule it breaks, MissingSize if nothing says the size of the images, FileError.
    """
    is_bag = address_of(Path(path)) is not None
    path, named = (Path(path), None) if is_bag else split_address(str(path))
    sources = [*(_sources_of_bag(path) if is_bag else [_file(path)]), *([] if second is None else [source_of(second)])]
    known = _recognised(sources[0])
    form = known or FORMATS[OWN]
    if len(sources) > form.files and not is_bag:
        raise InvalidInput(f"--with {second}: the cameras of a {form.title} file are all in one", where=str(path))
    if len(sources) > 1 and _recognised(sources[1]) != form:
        raise InvalidInput(f"is not a {form.title} file as {path} is", where=str(second))
    if known is None:
        _require_yaml(sources[0])
    try:
        file = _of_topics(form, sources, given) if is_bag else form.read(sources, given)
    except CamcalError as error:
        if known is None and isinstance(error, InvalidInput):
            error.message += f"; formats that are read: {', '.join(each.title for each in FORMATS.values())}"
        elif form.name != OWN and form.title not in error.message:
            error.message += f"; read as {form.title}"
        raise
    if form.name != OWN:
        doubted = () if form.is_library else implausible(file)
        doubts = (replace(warning, where=f"{path}: {warning.where}") for warning in doubted)
        origin = {"file": path.name, "format": form.name, "exact": True}
        file = replace(file, warnings=(*file.warnings, *doubts), converted_from=origin)
    warn_of(file.warnings, progress)
    return file if named is None else only(file, named, str(path))


def _require_yaml(source: Source) -> None:
    """Raise FileError for a file of no family that is no YAML either, and so not one of camcal's own."""
    if source.binary:
        raise FileError("is not a text file, and no binary camera file that camcal knows", where=str(source.path))
    if source.text.lstrip()[:1] == "<":
        root = re.search(r"<([\w:.-]+)", source.text)
        what = f"is XML with the root <{root[1][:40]}>" if root else "is XML without a root"
        raise FileError(f"{what}, of no camera file that camcal knows", where=str(source.path))


def _of_topics(form: CameraFormat, sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the cameras of several sources, by the names that these give them."""
    found = [form.read([source], given) for source in sources]
    cameras = {name: entry for file in found for name, entry in file.cameras.items()}
    return CameraFile(cameras, warnings=tuple(warning for file in found for warning in file.warnings))


def _sources_of_bag(path: Path) -> list[Source]:
    """Return every camera_info of a bag as the text of ROS's file; raises FileError."""
    from camcal.formats.cameras.ros import text_of
    from camcal.images.bag import camera_infos

    files.note_read(path)
    return [Source(Path(f"{path}#{topic}"), text_of(each, name_of_topic(topic))) for topic, each in camera_infos(path)]


def source_of(path: Path) -> Source:
    """Return a file with its text, of a bag its first camera_info; raises FileError if it cannot be read."""
    return _file(path) if address_of(path) is None else _sources_of_bag(path)[0]


def _file(path: Path) -> Source:
    content = files.read_bytes(path, _LARGEST)
    try:
        return Source(path, content.decode("utf-8-sig"))
    except UnicodeDecodeError:
        return Source(path, content.decode("latin-1"), binary=True)


def format_of(path: Path) -> CameraFormat:
    """Return the format of a camera file, camcal's own if it is of none.

    Raises FileError if it cannot be read, InvalidInput for a family that is not.
    """
    return _recognised(source_of(path)) or FORMATS[OWN]


def _recognised(source: Source) -> CameraFormat | None:
    """Return the format of a file, None if it is of none; raises InvalidInput for a family that is not read."""
    row = recognise(source.text)
    if row is None:
        return None
    if row.instead:
        raise InvalidInput(f"{row.title}: not read; {row.instead}", where=str(source.path))
    return FORMATS[row.name]


def is_camera_file(path: Path) -> bool:
    """Return whether a file is of a family of camera files; raises FileError if it cannot be read."""
    return recognise(source_of(path).text) is not None


def read_camera(path: str | Path, name: str | None = None) -> Camera:
    """Return one camera of a file, FILE or FILE#NAME; the name may be left out where there is only one.

    Raises InvalidInput if it is not clear which one is meant, and as `read` does.
    """
    return select(read(path), name, str(path)).camera


def select(file: CameraFile, name: str | None, where: str) -> CameraEntry:
    """Return the camera of that name, or the only one."""
    names = list(file.cameras)
    if name is None and len(names) > 1:
        one = f"{where}#{names[0]}"
        shown = ", ".join(names[:_LISTED]) + ", …" * (len(names) > _LISTED)
        raise InvalidInput(f"holds {len(names)} cameras ({shown}); choose one, such as {one}", where=where)
    if name is not None and name not in file.cameras:
        raise InvalidInput(f"no camera {name!r}{did_you_mean(name, names)}", where=where)
    return file.cameras[name or names[0]]


def only(file: CameraFile, name: str, where: str) -> CameraFile:
    """Return a file with one of its cameras; what joins it to others is left out."""
    own = {name_in(file, name): select(file, name, where)}
    return replace(file, cameras=own, transforms={}, joint_covariance=None)


def name_in(file: CameraFile, wanted: str | None) -> str:
    """Return the name of the camera that is wanted, of the only one for None; a lens of a library has none before."""
    names = list(file.cameras)
    return names[0] if wanted is None else wanted if wanted in names else name_of(wanted)


def format_for(path: Path, wanted: str | None, source: CameraFormat, *, by_suffix: bool = False) -> CameraFormat:
    """Return the format to write to a path: the one that is wanted, or the only one its name can mean.

    source: the format of what is written; camera files of other programs, and what goes to standard output, become
    camcal's where nothing says more. by_suffix: a name or suffix that one format alone has goes before what is wanted.
    Raises InvalidInput for an unknown name, a suffix that does not go with it, and where it is not clear.
    """
    if wanted is not None and wanted not in FORMATS:
        raise InvalidInput(f"--to {wanted}: no camera format of this name{did_you_mean(wanted, FORMATS)}")
    meant = _meant_by(path)
    if wanted is not None and not (by_suffix and meant is not None):
        form = FORMATS[wanted]
        if not form.suffixes:
            raise InvalidInput(f"--to {wanted}: {form.title} is read, not written")
        if files.is_stream(path):
            return form
        if path.suffix.lower() not in form.suffixes and not (form.in_folder and not path.suffix):
            raise InvalidInput(f"{form.title} is written as {' or '.join(form.suffixes)}", where=str(path))
        return form
    if files.is_stream(path):
        return FORMATS[OWN]
    if isinstance(meant, Row):
        what = f"is a name of {meant.title}, which is not written"
        raise InvalidInput(
            f"{what}: choose another one, or give --to and one of {', '.join(_writable())}", where=str(path)
        )
    if meant is not None:
        return meant
    known = _with_suffix(path)
    if known and source.name != OWN:
        return FORMATS[OWN]
    raise _unclear(path, known or [form for form in FORMATS.values() if path.suffix.lower() in form.suffixes])


def _unclear(path: Path, known: Sequence[CameraFormat]) -> InvalidInput:
    """Return the error of a path that may be several of the known formats, or is of none."""
    if not known and path.suffix:
        suffixes = dict.fromkeys(suffix for form in FORMATS.values() for suffix in form.suffixes)
        return InvalidInput(f"{path.suffix} is not a camera file; use one of {' '.join(suffixes)}", where=str(path))
    names = ", ".join([form.name for form in known] or _writable())
    kind = path.suffix or "a folder"
    several = "several formats" if len(known) != 1 else "another format only"
    return InvalidInput(f"{kind} is written in {several}: give --to and one of {names}", where=str(path))


def _writable() -> list[str]:
    """Return the names of the formats that are written."""
    return [form.name for form in FORMATS.values() if form.suffixes]


def _meant_by(path: Path) -> CameraFormat | Row | None:
    """Return the one format that a path can mean, a row that is not written, or None where it may mean several."""
    row = named(path.name)
    if row is not None:
        return FORMATS[row.name] if row.name else row
    known = _with_suffix(path)
    return known[0] if len(known) == 1 else None


def _with_suffix(path: Path) -> list[CameraFormat]:
    return [form for form in (FORMATS[name] for name in _USUAL) if path.suffix.lower() in form.suffixes]


def left_out(file: CameraFile, form: CameraFormat) -> tuple[str, ...]:
    """Return in words what a file holds that a format does not, beside lenses, sizes and transforms of cameras."""
    return tuple(dict.fromkeys(_left_out(file, form)))


def _left_out(file: CameraFile, form: CameraFormat) -> Iterator[str]:
    if form.name == OWN:
        return
    entries: Sequence[CameraEntry] = list(file.cameras.values())
    held = {
        "standard deviations": any(entry.camera.covariance is not None or entry.projection for entry in entries),
        "valid region": any(entry.valid for entry in entries),
        "quality": any(entry.quality.keys() - ({"rms_px"} if "rms" in form.keeps else set()) for entry in entries),
        "noise": any(entry.noise for entry in entries),
        "verdict": any(entry.verdict for entry in entries),
        "sensor": any(entry.sensor for entry in entries),
        "lenses of single colours": any(entry.channels for entry in entries),
        "covariance of transforms": bool(file.joint_covariance)
        or any(item.covariance is not None for item in file.transforms.values()),
        "shape of the board": file.board_shape is not None,
        "provenance": bool(file.provenance),
    }
    yield from (name for name, there in held.items() if there and name not in form.keeps)
    every = [frame for name in file.transforms for frame in frames_of(name)]
    if form.frames == ANY_FRAME:
        first = next(iter(file.cameras))
        loose = (name for name in file.transforms if first not in frames_of(name))
        yield from (name for name in loose if pose_between(file, first, frames_of(name)[0]) is None)
        return
    for name in file.transforms:
        ends = [frame for frame in frames_of(name) if every.count(frame) == 1]
        if any(frame not in file.cameras and frame not in form.frames for frame in ends):
            yield name


def write(path: Path, file: CameraFile, form: CameraFormat, nearest: "Nearest | None" = None) -> None:
    """Write a camera file in a format, every number with all its digits; by default its lenses exactly.

    Raises InvalidInput as `nearest.prepared` does, and for what the format's own `write` says; FileError.
    """
    from camcal.formats.cameras.nearest import EXACT, prepared

    form.write(path, prepared(file, form, str(path), nearest or EXACT).file)
