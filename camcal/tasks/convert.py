"""`camcal convert`: a camera file of one format to another."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from camcal.cameras.refit import Refit
from camcal.formats import cameras, provenance
from camcal.formats.camera_file import CameraFile
from camcal.formats.cameras.record import CameraFormat, Given
from camcal.options import command_line
from camcal.progress import SILENT, Progress
from camcal.run.outputs import claim, writes
from camcal.run.paths import split_address
from camcal.tasks.given_camera import require_no_image
from camcal.tasks.options import ConvertFileOptions


@dataclass(frozen=True, eq=False)
class ConvertedFile:
    """The cameras as they were written, the formats they come from and go to, and the files.

    refits: the lenses that are not exact, by the names of their cameras. left_out: in words, what was known of the
    cameras and the format does not hold; lenses and transforms are all there.
    """

    file: CameraFile
    source: CameraFormat
    target: CameraFormat
    outputs: tuple[Path, ...]
    refits: Mapping[str, Refit]
    left_out: tuple[str, ...]


@writes
def convert(options: ConvertFileOptions, progress: Progress = SILENT) -> ConvertedFile:
    """Return what was written to options.output.

    Raises InvalidInput for a lens or for more cameras than the format holds, where nothing says the size of the images
    or the format, and for an output that is an input; FileError.
    """
    path, name = split_address(options.source)
    require_no_image(path)
    file = cameras.read(path, progress, Given(options.given.size, options.given.model), options.second)
    source = cameras.format_of(path)
    target = cameras.format_for(options.output, options.to, source)
    if (wanted := options.camera or name) is not None:
        file = _alone(file, wanted, str(path))
    prepared = cameras.prepared(file, target, str(options.output), options.max_error_px)
    file = prepared.file
    if not file.provenance and target.name == cameras.OWN:
        file = replace(file, provenance=provenance.build(command_line("convert", options), None))
    outputs = target.outputs(options.output, file)
    claim(outputs)
    target.write(options.output, file)
    return ConvertedFile(file, source, target, outputs, prepared.refits, cameras.left_out(file, target))


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
            {
                "name": name,
                "model": entry.camera.model.name,
                "image_size": entry.camera.image_size,
                "refit": _figures(converted.refits.get(name)),
            }
            for name, entry in converted.file.cameras.items()
        ],
        "transforms": list(converted.file.transforms),
        "left_out": list(converted.left_out),
    }


def _figures(refit: Refit | None) -> dict[str, float] | None:
    return None if refit is None else {"rms_px": refit.rms_px, "max_px": refit.max_px}


def words(converted: ConvertedFile) -> str:
    """Return in a line the format that was written, how exactly, and what it does not hold."""
    refits = [
        f"{name} as the nearest {found.camera.model.name}, off by up to {found.max_px:.2g} px ({found.rms_px:.2g} RMS)"
        for name, found in converted.refits.items()
    ]
    left_out = f"; not held there: {', '.join(converted.left_out)}" if converted.left_out else ""
    return f"{converted.target.title}, {', '.join(refits) or 'exact'}{left_out}"
