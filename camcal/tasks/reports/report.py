"""`camcal report`: a camera, rig or detections file in, one HTML page out.

The page of detections is that of their calibration; that of a file alone says what it holds, and how to get the rest.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

from camcal import files
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.formats import cameras, corner_lists, detections
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.messages import Message, counted
from camcal.options import given_words
from camcal.progress import SILENT, Progress, warn_of
from camcal.quality.projection_uncertainty import projection_uncertainty
from camcal.report.figures.board import board_height, board_shape
from camcal.report.figures.figure import Plot
from camcal.report.figures.image_plane import projection_uncertainty as uncertainty_plot
from camcal.report.page.calibration import board_section, focal_figure
from camcal.report.page.record import (
    BAD,
    GOOD,
    UNKNOWN,
    Figure,
    Page,
    PageVerdict,
    Section,
    ShownMessage,
    Table,
    rendered,
    sentence,
    shown_messages,
    shown_reasons,
)
from camcal.report.page.thumbnails import pictures
from camcal.report.rig import DEPTH_COLUMNS, PAIR_COLUMNS, depth_rows, pair_rows
from camcal.run.outputs import writes
from camcal.tasks.calibration.board_views import OWN_SUFFIXES, is_table
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.inspect import (
    Inspection,
    camera_lines,
    image_rows,
    inspect,
    parameter_rows,
    transform_lines,
)
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.file_options import InspectOptions, ReportOptions
from camcal.tasks.reports.closing import environment, made, origin_section, repeat_section
from camcal.tasks.rigs.calibrate_rig import rig
from camcal.tasks.rigs.options import RigSettings, RigTaskOptions

_REST = (
    "Residuals, coverage, poses and images are not in this file. They need the detections: camcal report DETECTIONS, "
    "or --report with camcal calibrate and camcal rig."
)


@dataclass(frozen=True)
class Reported:
    """What a report was made of. trustworthy: None where a file does not say it. failures: why it is not."""

    output: Path
    cameras: tuple[str, ...]
    trustworthy: bool | None
    failures: tuple[Message, ...] = ()


@writes
def report(options: ReportOptions, progress: Progress = SILENT) -> Reported:
    """Return what was written to options.output: the report of a file, or of the calibration from detections.

    Raises InvalidInput or FileError; InsufficientData or NotConverged for detections that no calibration can be made
    from, after writing the report that says why.
    """
    if options.output is None:
        raise InvalidInput("a report needs a file: give -o report.html")
    if not is_table(options.file, OWN_SUFFIXES):
        return _report_file(options, options.output, progress)
    board, size = options.board, options.image_size
    if _has_several_cameras(options):
        models = () if options.model is None else (options.model,)
        settings = RigSettings(board=board, models=models, image_size=size, report=options.output)
        found = rig(RigTaskOptions((options.file,), settings), progress)
        return Reported(options.output, tuple(found.cameras), found.trustworthy, found.failures)
    how = CalibrateOptions((options.file,), board=board, model=options.model, image_size=size, report=options.output)
    single = calibrate(how, progress)
    return Reported(options.output, tuple(single.file.cameras), single.trustworthy, single.failures)


def _has_several_cameras(options: ReportOptions) -> bool:
    """Return whether a detections file names several cameras; a .vnl names none."""
    if Path(options.file).suffix.lower() == corner_lists.VNL:
        return False
    return len({view.camera for view in detections.read_csv(Path(options.file)).views}) > 1


def _report_file(options: ReportOptions, output: Path, progress: Progress) -> Reported:
    if words := given_words(options):
        raise InvalidInput(f"{words[0]} applies to detections, not to a camera file", where=options.file)
    asked = InspectOptions(options.file)
    inspection = inspect(asked)
    if (name := asked.address[1]) is not None:
        inspection = replace(inspection, file=cameras.only(inspection.file, name, options.file))
    warn_of(inspection.file.warnings, progress)
    files.write_text(output, file_page(inspection))
    verdicts = [entry.verdict for entry in inspection.file.cameras.values()]
    known = [each for each in verdicts if each is not None]
    trustworthy = all(each.trustworthy for each in known) if len(known) == len(verdicts) else None
    failures = tuple(Message("untrustworthy", reason) for each in known for reason in each.reasons)
    return Reported(output, tuple(inspection.file.cameras), trustworthy, failures)


def file_page(inspection: Inspection) -> str:
    """Return the report of a camera file as HTML."""
    file = inspection.file
    names = ", ".join(file.cameras)
    own = file.provenance
    origin = origin_section(
        own, {**_versions(own), **{f"report: {key}": value for key, value in environment().items()}}, []
    )
    page = Page(
        f"Camera {names}" if len(file.cameras) == 1 else f"Cameras {names}",
        f"{counted(len(file.cameras), 'camera')} of a file",
        _file_verdict(file),
        (*_file_reasons(file), *shown_messages((), file.warnings)),
        figures=tuple(_file_figures(file)),
        sections=(
            *(_camera_section(name, entry, inspection) for name, entry in file.cameras.items()),
            *_rig_sections(inspection),
            *_board_sections(file),
            *_image_sections(file),
            origin,
            repeat_section(str(own.get("command", "not recorded")), again=False),
        ),
        made=made(),
    )
    return rendered(page)


def _file_verdict(file: CameraFile) -> PageVerdict:
    verdicts = [entry.verdict for entry in file.cameras.values()]
    if any(each is not None and not each.trustworthy for each in verdicts):
        return PageVerdict(BAD, "Do not trust this calibration", "The file says so, for the reasons below.", _REST)
    if verdicts and all(each is not None for each in verdicts):
        return PageVerdict(GOOD, "Trustworthy", "The file says so: all checks passed when it was written.", _REST)
    return PageVerdict(UNKNOWN, "Unknown", "The file does not say whether the calibration may be trusted.", _REST)


def _file_reasons(file: CameraFile) -> tuple[ShownMessage, ...]:
    return tuple(
        each
        for name, entry in file.cameras.items()
        if entry.verdict is not None
        for each in shown_reasons(entry.verdict.reasons, name if len(file.cameras) > 1 else "")
    )


def _versions(provenance: Mapping[str, object]) -> dict[str, str]:
    """Return the versions that a file was made with."""
    made_by = {"tool": f"{provenance.get('tool', 'unknown')} {provenance.get('tool_version', '')}".strip()}
    found = provenance.get("libraries")
    return made_by | ({str(key): str(value) for key, value in found.items()} if isinstance(found, Mapping) else {})


def _file_figures(file: CameraFile) -> Iterator[Figure]:
    for name, entry in file.cameras.items():
        camera, of = entry.camera, f"{name}: " if len(file.cameras) > 1 else ""
        yield focal_figure(camera, of)
        if "rms_px" in entry.quality:
            used = f"{entry.quality['images_used']:.0f} images" if "images_used" in entry.quality else ""
            yield Figure(f"{of}RMS", f"{entry.quality['rms_px']:.3g} px", used)
        width, height = camera.image_size
        yield Figure(f"{of}lens model" if of else "Lens model", camera.model.name, f"{width} x {height} px")


def _camera_section(name: str, entry: CameraEntry, inspection: Inspection) -> Section:
    """Return the section on one camera: parameters, field of view, projection uncertainty."""
    lines = [sentence(line) for line in camera_lines(entry, inspection.fields[name])]
    heads = ("parameter", "value", "± std")
    table = Table.of(f"Lens parameters of {name}", heads, parameter_rows(entry.camera))
    found = pictures([*_uncertainty(entry)], f"{name}-")
    return Section(f"camera-{name}", f"Camera {name}", lines, pictures=list(found.values()), tables=[table])


def _uncertainty(entry: CameraEntry) -> Iterator[Plot]:
    try:
        found = projection_uncertainty(entry.camera, circle=entry.image_circle)
    except InvalidInput:  # no covariance is known
        return
    if found.figures():  # else no pixel is in the domain of the lens
        yield uncertainty_plot(found, entry.camera.image_size, entry.image_circle)


def _rig_sections(inspection: Inspection) -> Iterator[Section]:
    lines = [f"{line}." for line in transform_lines(inspection.file)]
    rig = inspection.rig
    if rig is None:
        if lines:
            yield Section("transforms", "Transforms", lines)
        return
    error = rig.measured.get("epipolar_rms_px")
    lines += [f"Epipolar error of the calibration images {error:.3g} px RMS."] if isinstance(error, float) else []
    tables = [Table.under("Pairs of cameras (vergence: + converging)", PAIR_COLUMNS, pair_rows(rig.pairs))]
    tables += [
        Table.under(f"Depth error of {pair.first}, {pair.second} (1 sigma)", DEPTH_COLUMNS, rows)
        for pair in rig.pairs
        if (rows := depth_rows(pair))
    ]
    yield Section("transforms", "Transforms and baselines", lines, tables=tables)


def _board_sections(file: CameraFile) -> Iterator[Section]:
    if file.board_shape is not None:
        plots = [board_shape(file.board_shape), board_height(file.board_shape)]
        found = pictures([plot for plot in plots if plot is not None])
        yield board_section(file.board_shape, list(found.values()))


def _image_sections(file: CameraFile) -> Iterator[Section]:
    if rows := image_rows(file):
        heads = ("image", "points", "RMS, px", "not used because")
        table = Table.of("Images of the calibration", heads, rows)
        yield Section("images", "Images", tables=[table])
