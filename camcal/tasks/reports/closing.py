"""What all reports share: photographs, the programs and the machine they depend on, and their last sections."""

import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import camcal
from camcal import files
from camcal.arrays import Array
from camcal.errors import CamcalError
from camcal.formats import native, provenance
from camcal.formats.camera_file import CameraFile
from camcal.raw.options import ImageReadOptions
from camcal.raw.reading import read_detection_image
from camcal.report.page.record import Section, Table
from camcal.report.page.thumbnails import MOST, photo_key, photograph
from camcal.run.process import processor_name
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.video_frames import Video

_DRAWN_BY = ("matplotlib", "jinja2")


def origin_section(provenance: Mapping[str, Any], environment: Mapping[str, str], lines: Sequence[str]) -> Section:
    """Return the section on versions, inputs with their hashes, and the command; lines: what else was reported."""
    rows = [["command", str(provenance.get("command", "unknown"))]]
    rows += [["created", str(provenance["created"])]] if "created" in provenance else []
    rows += [[name, version] for name, version in environment.items()]
    rows += [
        [f"board {name}", " x ".join(map(str, value)) if isinstance(value, list) else str(value)]
        for name, value in dict(provenance.get("board", {})).items()
    ]
    if totals := provenance.get("image_totals"):
        rows.append(["images", f"{totals['used']} of {totals['listed']} used; SHA-256 of the list {totals['sha256']}"])
    tables = [Table.of("Program, machine and board", ("what", "value"), rows)]
    images = [
        [str(image.get("file", "")), str(image.get("sha256", "not recorded"))]
        for image in provenance.get("images", [])
        if isinstance(image, Mapping)
    ]
    if images:
        tables.append(Table.of("Inputs", ("file", "SHA-256"), images))
    return Section("provenance", "Provenance", list(lines), tables=tables)


def repeat_section(command: str, *, again: bool = True) -> Section:
    """Return the section on how to repeat a result; again: whether the page carries what that needs."""
    lines = list(_repeat_lines(again=again))
    commands = (["camcal rerun REPORT.html -o repeated"] if again else []) + [command]
    return Section("repeat", "How to repeat it", lines, commands=commands)


def _repeat_lines(*, again: bool) -> Iterator[str]:
    if again:
        yield (
            "This file carries the detections and the options. The first command calibrates again from these and "
            "writes the camera or rig file and this report: the same bytes on the same machine with the same "
            "libraries. Elsewhere it says what differs; differences below 1e-6 standard deviations count as none."
        )
        yield "The second command is the one that made this report."
    else:
        yield "The command that made the file:"


def environment() -> dict[str, str]:
    """Return versions and machine by name, in the order in which they are listed."""
    found = {"camcal": camcal.__version__, "python": platform.python_version(), **provenance.libraries()}
    found |= {name: metadata.version(name) for name in _DRAWN_BY}
    return found | {"system": f"{platform.system()} {platform.machine()}", "processor": processor_name()}


def environment_differences(recorded: dict[str, str], here: dict[str, str]) -> list[str]:
    """Return what differs between two environments, a line each."""
    names = dict.fromkeys([*recorded, *here])
    return [
        f"{name}: {recorded.get(name, 'none')} in the report, {here.get(name, 'none')} here"
        for name in names
        if recorded.get(name) != here.get(name)
    ]


def made() -> str:
    """Return the program that makes a page, with its version."""
    return f"camcal {camcal.__version__}"


def result_text(file: CameraFile, name: str) -> str:
    """Return the text of a camera file that is called so."""
    with files.unwatched(), TemporaryDirectory() as folder:
        path = Path(folder) / name
        native.write(path, file)
        return files.read_text(path)


def images_of(file: CameraFile) -> list[dict[str, Any]]:
    """Return the images that a calibration lists in its provenance."""
    images = file.provenance.get("images")
    return images if isinstance(images, list) else []


def closing_sections(
    provenance: Mapping[str, Any], environment: Mapping[str, str], lines: Sequence[str]
) -> tuple[Section, ...]:
    """Return the sections on provenance and repetition; lines: what else the calibration reported."""
    command = str(provenance.get("command", "camcal"))
    return origin_section(provenance, environment, lines), repeat_section(command)


def photographs(
    images: Sequence[str],
    views: Sequence[BoardDetection],
    reading: ImageReadOptions,
    places: Mapping[str, Path],
    videos: Sequence[Video] = (),
    most: int = MOST,
) -> dict[str, str]:
    """Return the photographs of the first `most` images as data URIs by `photo_key`.

    places: the images whose names are not their paths. videos: those whose frames are among the images. Images that are
    gone and those that were made to fit the size of the others have none.
    """
    by_name = {view.image: view for view in views}
    found = {}
    for image, gray in _grays(images[:most], reading, places, videos):
        view = by_name[image]
        if gray.shape[::-1] == view.size:
            found[photo_key(view.camera, image)] = photograph(gray)
    return found


def _grays(
    images: Sequence[str], reading: ImageReadOptions, places: Mapping[str, Path], videos: Sequence[Video]
) -> Iterator[tuple[str, Array]]:
    """Yield the images (H, W) uint8 that can be read under their names, frames of videos last."""
    for image in images:
        path = places.get(image, Path(image))
        with suppress(CamcalError, OSError):
            if path.is_file():
                yield image, read_detection_image(path, reading).gray
    for video in videos:
        yield from ((frame.name, frame.image.pixels) for frame in video.only(images).frames())
