"""`camcal convert`: a camera file of one format to another, exactly or not at all."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from camcal.formats import cameras, provenance
from camcal.formats.camera_file import CameraFile
from camcal.formats.cameras.record import CameraFormat, Given
from camcal.options import command_line
from camcal.progress import SILENT, Progress
from camcal.run.paths import refuse_overwriting, split_address
from camcal.tasks.given_camera import require_no_image
from camcal.tasks.options import ConvertFileOptions


@dataclass(frozen=True, eq=False)
class ConvertedFile:
    """The cameras as they were written, the formats they come from and go to, and the files.

    left_out: in words, what was known of them and the format does not hold; lenses and transforms are all there.
    """

    file: CameraFile
    source: CameraFormat
    target: CameraFormat
    outputs: tuple[Path, ...]
    left_out: tuple[str, ...]


def convert(options: ConvertFileOptions, progress: Progress = SILENT) -> ConvertedFile:
    """Return what was written to options.output.

    Raises InvalidInput for a lens or for more cameras than the format holds, where nothing says the size of the images
    or the format, and for an output that is an input; FileError.
    """
    path, name = split_address(options.source)
    require_no_image(path)
    source = cameras.format_of(path)
    target = cameras.format_for(options.output, options.to, source)
    file = cameras.read(path, progress, Given(options.given.size, options.given.model), options.second)
    if (wanted := options.camera or name) is not None:
        file = _alone(file, wanted, str(path))
    prepared = cameras.prepared(file, target, str(options.output))
    if not prepared.provenance and target.name == cameras.OWN:
        prepared = replace(prepared, provenance=provenance.build(command_line("convert", options), None))
    outputs = target.outputs(options.output, prepared)
    refuse_overwriting(outputs, [each for each in (path, options.second) if each is not None])
    target.write(options.output, prepared)
    return ConvertedFile(prepared, source, target, outputs, cameras.left_out(file, target))


def _alone(file: CameraFile, name: str, where: str) -> CameraFile:
    """Return a file with one of its cameras; what joins it to others is left out."""
    entry = cameras.select(file, name, where)
    return replace(file, cameras={name: entry}, transforms={}, joint_covariance=None)


def document(converted: ConvertedFile) -> dict[str, Any]:
    """Return what was written as plain data for --json."""
    return {
        "source_format": converted.source.name,
        "format": converted.target.name,
        "outputs": list(converted.outputs),
        "cameras": [
            {"name": name, "model": entry.camera.model.name, "image_size": entry.camera.image_size}
            for name, entry in converted.file.cameras.items()
        ],
        "transforms": list(converted.file.transforms),
        "left_out": list(converted.left_out),
    }
