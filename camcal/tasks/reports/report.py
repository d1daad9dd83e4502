"""`camcal report`: a camera, rig or detections file in, one HTML page out."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camcal import files, messages
from camcal.errors import InvalidInput
from camcal.formats import detections, vnl
from camcal.messages import Message
from camcal.options import given_words
from camcal.progress import SILENT, Progress, warn_of
from camcal.run.outputs import writes
from camcal.tasks.calibration.board_views import is_table
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.inspect import inspect
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.options import InspectOptions
from camcal.tasks.reports.options import ReportOptions
from camcal.tasks.rigs.calibrate_rig import rig
from camcal.tasks.rigs.options import RigSettings, RigTaskOptions


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
    if not is_table(options.file):
        return _of_file(options, options.output, progress)
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
    if Path(options.file).suffix.lower() == vnl.SUFFIX:
        return False
    return len({view.camera for view in detections.read_csv(Path(options.file)).views}) > 1


def _of_file(options: ReportOptions, output: Path, progress: Progress) -> Reported:
    from camcal.tasks.reports.file_page import file_page

    if words := given_words(options):
        raise InvalidInput(f"{words[0]} applies to detections, not to a camera file", where=options.file)
    inspection = inspect(InspectOptions(options.file))
    warn_of(inspection.file.warnings, progress)
    files.write_text(output, file_page(inspection))
    verdicts = [entry.verdict for entry in inspection.file.cameras.values()]
    known = [each for each in verdicts if each is not None]
    trustworthy = all(each.trustworthy for each in known) if len(known) == len(verdicts) else None
    failures = tuple(Message("untrustworthy", reason) for each in known for reason in each.reasons)
    return Reported(output, tuple(inspection.file.cameras), trustworthy, failures)


def document(found: Reported) -> dict[str, Any]:
    """Return what was written as plain data for --json."""
    return {
        "output": found.output,
        "cameras": list(found.cameras),
        "trustworthy": found.trustworthy,
        "failures": messages.as_data(found.failures),
    }
