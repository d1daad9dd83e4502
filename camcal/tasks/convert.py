"""`camcal convert`: a camera file of one format to others."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from camcal import files
from camcal.cameras.catalogue import model_named
from camcal.cameras.refit import Refit
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.formats import cameras, provenance, split_address
from camcal.formats.camera_file import CameraFile, Framing, framed
from camcal.formats.cameras.nearest import Nearest, prepared
from camcal.formats.cameras.record import EVERY_LENS, CameraFormat, Given, named
from camcal.options import command_line
from camcal.progress import SILENT, Progress
from camcal.run.outputs import claim, writes
from camcal.tasks.file_options import ConvertFileOptions
from camcal.tasks.given_camera import framing_of, require_no_image


@dataclass(frozen=True, eq=False)
class ConvertedFile:
    """The cameras as they are written to a path, their format, and the files.

    refits: the lenses that are not exact, by the names of their cameras. left_out: in words, what is known of the
    cameras and the format does not hold; lenses and transforms are all there.
    """

    file: CameraFile
    path: Path
    format: CameraFormat
    outputs: tuple[Path, ...]
    refits: Mapping[str, Refit]
    left_out: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ConvertReport:
    """The format of the camera file that was read, and what was written; plot: the figure, None for none."""

    source: CameraFormat
    files: tuple[ConvertedFile, ...]
    plot: Path | None = None

    @property
    def outputs(self) -> tuple[Path, ...]:
        """All files."""
        figures = () if self.plot is None else (self.plot,)
        return (*(path for file in self.files for path in file.outputs), *figures)


@writes
def convert(options: ConvertFileOptions, progress: Progress = SILENT) -> ConvertReport:
    """Return what was written to options.outputs: all of them, or none.

    Raises InvalidInput for a lens or for more cameras than a format holds, where nothing says the size of the images
    or a format, and for an output that is an input; FileError.
    """
    if len(options.outputs) > 1 and any(map(files.is_stream, options.outputs)):
        raise InvalidInput("standard output takes one file; name the others in calls of their own")
    path, name = split_address(options.source)
    require_no_image(path)
    file = cameras.read(path, progress, Given(options.given.size, options.given.model), options.second)
    source = cameras.format_of(path)
    if (wanted := options.camera or name) is not None:
        file = cameras.only(file, wanted, str(path))
    file = framed(file, framing_of(options.given.part))
    written = tuple(_convert_file(file, output, source, options) for output in options.outputs)
    refits = [(file.cameras[name].camera, found) for each in written for name, found in each.refits.items()]
    if options.plot is not None and not refits:
        raise InvalidInput("--plot draws the difference of the nearest lens; the lenses written here are exact")
    report = ConvertReport(source, written, options.plot)
    claim(report.outputs)
    for each in written:
        each.format.write(each.path, each.file)
    if options.plot is not None:
        from camcal.report.figures.differences import refit_difference
        from camcal.report.figures.figure import encoded

        files.write_bytes(options.plot, encoded(refit_difference(*refits[0]), options.plot.suffix))
    return report


def _convert_file(file: CameraFile, output: Path, source: CameraFormat, options: ConvertFileOptions) -> ConvertedFile:
    """Return what is to be written to an output."""
    one_of_several = len(options.outputs) > 1
    changed = options.refit is not None or framing_of(options.given.part) != Framing()
    own = changed and output.suffix.lower() in cameras.FORMATS[cameras.OWN].suffixes
    wanted = options.to or (cameras.OWN if own and not named(output.name) else None)
    target = cameras.format_for(output, wanted, source, by_suffix=one_of_several)
    theta = math.inf if options.max_theta_deg is None else math.radians(options.max_theta_deg)
    refit = None if options.refit is None else model_named(options.refit).name
    if refit is not None and target.models is not EVERY_LENS and refit not in target.models:
        known = f"{target.title} has the lens models {', '.join(target.models)}"
        raise InvalidInput(f"--refit {options.refit}: {known}", where=str(output))
    found = prepared(file, target, str(output), Nearest(refit, options.max_error_px, theta))
    fitting = found.file
    if not fitting.provenance and target.name == cameras.OWN:
        fitting = replace(fitting, provenance=provenance.build(command_line("convert", options), None))
    outputs = target.outputs(output, fitting)
    return ConvertedFile(fitting, output, target, outputs, found.refits, cameras.left_out(fitting, target))


def document(report: ConvertReport) -> dict[str, Any]:
    """Return what was written as plain data for --json."""
    return {"source_format": report.source.name, "files": [_file_data(file) for file in report.files]}


def _file_data(converted: ConvertedFile) -> dict[str, Any]:
    return {
        "format": converted.format.name,
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
    if refit is None:
        return None
    return {"rms_px": refit.rms_px, "max_px": refit.max_px, "max_theta_deg": math.degrees(refit.max_theta)}


def words(converted: ConvertedFile) -> str:
    """Return in a line the format that was written, how exactly, and what it does not hold."""
    refits = [
        f"{name} as the nearest {found.camera.model.name}, off by up to {found.max_px:.2g} px ({found.rms_px:.2g} RMS) "
        f"up to {math.degrees(found.max_theta):.0f}° from the axis"
        for name, found in converted.refits.items()
    ]
    left_out = f"; not stored: {', '.join(converted.left_out)}" if converted.left_out else ""
    said = converted.format.usage(converted.file) if converted.format.usage else converted.format.note
    usage = f"; {said}" if said else ""
    return f"{converted.format.title}, {', '.join(refits) or 'exact'}{left_out}{usage}"
