"""`camcal rerun`: a report is calibrated again from the detections and options that it carries, and compared."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from camcal import files
from camcal.calibrate.rigs.captures import Captures
from camcal.errors import CamcalError, GateFailed, InsufficientData, InvalidInput, Located, NotConverged
from camcal.formats import boards, page_data
from camcal.formats.page_data import CALIBRATE, PageData
from camcal.messages import Message
from camcal.progress import SILENT, Progress
from camcal.report.page.thumbnails import PHOTO
from camcal.run.outputs import claim, writes
from camcal.targets.detection import BoardDetection, Detections
from camcal.tasks.calibration import calibrate as calibration
from camcal.tasks.calibration.board_views import BoardViews
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.reports import agreement, camera_page, carried, rig_page
from camcal.tasks.reports.agreement import Difference
from camcal.tasks.reports.camera_page import CAMERA_NAME
from camcal.tasks.reports.closing import result_text
from camcal.tasks.reports.environment import differences, environment
from camcal.tasks.reports.options import RerunOptions
from camcal.tasks.reports.rig_page import RIG_NAME
from camcal.tasks.rigs import calibrate_rig
from camcal.tasks.rigs.matching import Matched
from camcal.tasks.rigs.options import RigSettings
from camcal.tasks.rigs.rig_views import RigViews

REPORT_NAME = "report.html"
_FILES = (".html", ".yaml", ".yml", ".json")


@dataclass(frozen=True)
class Rerun:
    """What was made again. same: whether the report has the same bytes. environment: what differs of versions and
    machine. differences: figures that differ. outputs: the files written.
    """

    same: bool
    environment: tuple[str, ...]
    differences: tuple[Difference, ...]
    outputs: tuple[Path, ...]


@dataclass(frozen=True)
class _Again:
    """A page made again: its text, the text of the camera file and its name, and why there is none."""

    page: str
    result: str = ""
    refusal: str = ""


@writes
def rerun(options: RerunOptions, progress: Progress = SILENT) -> Rerun:
    """Return how the calibration of a report differs from the same one made here, after writing both of its files.

    Raises InvalidInput or FileError for what is no report, or a damaged one.
    """
    if options.output.suffix.lower() in _FILES and not options.output.is_dir():
        what = f"is the name of a file; -o is a folder, for {REPORT_NAME} and the camera file"
        raise InvalidInput(what, where=str(options.output))
    data = page_data.read(options.file, PHOTO)
    name = CAMERA_NAME if data.run["command"] == CALIBRATE else RIG_NAME
    output = options.output / REPORT_NAME
    refused = bool(data.run.get("refusal"))
    claim([output] if refused else [output, options.output / name])
    with Located(options.file):
        before = None if refused else agreement.parsed(data.run["result"], f"{options.file}: result")
        again = _calibrated(data, options, progress)
    files.write_text(output, again.page)
    same = files.read_bytes(options.file) == files.utf8(again.page)
    found = agreement.refusal_difference(data.run.get("refusal", ""), again.refusal)
    if before is not None and again.result:
        found = agreement.differences(before, agreement.parsed(again.result, name))
    elsewhere = differences(agreement.recorded_environment(data.run), environment())
    written = (output,) if not again.result else (options.output / name, output)
    return Rerun(same, tuple(elsewhere), tuple(found), written)


def require_agreement(found: Rerun) -> None:
    """Raise GateFailed if figures differ."""
    if found.differences:
        values = {"figures": len(found.differences)}
        text = f"{len(found.differences)} figures differ by more than {agreement.EQUAL:g} standard deviations"
        raise GateFailed.of([Message("rerun_differs", text, values)])


def _calibrated(data: PageData, options: RerunOptions, progress: Progress) -> _Again:
    """Return the page made again; the camera or rig file is written to the folder."""
    again = _camera if data.run["command"] == CALIBRATE else _rig
    with TemporaryDirectory() as guesses:
        try:
            return again(data, options.output, Path(guesses), progress)
        except CamcalError as error:
            if error.where and error.where.startswith(guesses):
                error.where = f"{options.file}: --guess"
            raise


def _camera(data: PageData, folder: Path, guesses: Path, progress: Progress) -> _Again:
    run = data.run
    original = carried.options_of(CalibrateOptions, run["options"])
    if original.reading.colours:
        raise InvalidInput("the lenses of single colours are calibrated from images, which a report does not carry")
    guess = next(iter(carried.unpacked_guesses(run, original, guesses)), None)
    model = original.model or run.get("models", {}).get(original.name)
    how = replace(original, output=folder / CAMERA_NAME, guess=guess, model=model, refine=None)
    board = boards.from_block(run["board"])
    seen = BoardViews(board, _with_hashes(data), lines=tuple(run.get("lines", ())), table=True)
    try:
        found = calibration.calibrated(lambda: seen, how, progress, run["words"])
    except (InsufficientData, NotConverged) as error:
        return _Again(
            camera_page.refusal_text(seen, original.name, error, _now(run), data.photos), refusal=error.message
        )
    candidates = carried.candidates_of(run["candidates"]) if "candidates" in run else None
    found = replace(
        found,
        warnings=carried.messages_of(run["warnings"]),
        lines=tuple(run["lines"]),
        failed=tuple(run["failed"]),
        refinement=carried.refinement_of(run.get("refinement")),
        candidates=found.candidates if candidates is None else candidates.get((original.name,), ()),
    )
    text = result_text(found.file, CAMERA_NAME)
    return _Again(camera_page.page_text(found, _now(run, text), data.photos), text)


def _rig(data: PageData, folder: Path, guesses: Path, progress: Progress) -> _Again:
    run = data.run
    original = carried.options_of(RigSettings, run["options"])
    guess = carried.unpacked_guesses(run, original, guesses)
    models = tuple(f"{name}={model}" for name, model in run["models"].items()) if "models" in run else original.models
    how = replace(original, output=folder / RIG_NAME, guess=tuple(guess), models=models, refine=None)
    seen = _captures(data)
    try:
        found = calibrate_rig.calibrated(lambda: seen, how, run["words"], progress)
    except (InsufficientData, NotConverged) as error:
        return _Again(rig_page.refusal_text(seen, error, _now(run), data.photos), refusal=error.message)
    found = replace(
        found,
        warnings=carried.messages_of(run["warnings"]),
        lines=tuple(run["lines"]),
        refinement=carried.refinement_of(run.get("refinement")),
        candidates=carried.candidates_of(run["candidates"]) if "candidates" in run else found.candidates,
    )
    text = result_text(found.file, RIG_NAME)
    return _Again(rig_page.page_text(found, _now(run, text), data.photos), text)


def _now(run: Mapping[str, Any], result: str = "") -> dict[str, Any]:
    """Return what a page that is made here carries."""
    return {**run, "environment": environment(), "result": result}


def _with_hashes(data: PageData) -> Detections:
    """Return the detections with the hashes of their images; "" stands for one that was not recorded."""
    hashes, alone = data.run.get("hashes", {}), data.run["command"] == CALIBRATE
    keys = [carried.hash_key(None if alone else view.camera, view.image) for view in data.detections.views]
    views = [replace(view, sha256=hashes.get(key, "")) for key, view in zip(keys, data.detections.views, strict=True)]
    return replace(data.detections, views=tuple(views))


def _captures(data: PageData) -> RigViews:
    """Return the captures that a page carries; raises InvalidInput where they do not match its detections."""
    run = data.run
    if "captures" not in run:
        raise InvalidInput("captures: missing key")
    block, found = run["captures"], _with_hashes(data)
    by_name: dict[tuple[str, str], BoardDetection] = {(view.camera, view.image): view for view in found.views}
    try:
        rows = tuple(
            tuple(
                by_name[camera, image] if image else None for camera, image in zip(block["cameras"], row, strict=True)
            )
            for row in block["images"]
        )
    except (KeyError, ValueError) as error:
        raise InvalidInput(f"captures: {error} is not among the detections") from error
    captures = Captures(tuple(block["cameras"]), tuple(block["names"]), rows)
    matched = Matched(captures, block["matched_by"], tuple(block["unmatched"]), block.get("largest_s"))
    return RigViews(
        boards.from_block(run["board"]), matched, found.circles, lines=tuple(run.get("lines", ())), table=True
    )


def document(found: Rerun) -> dict[str, Any]:
    """Return the comparison as plain data for --json."""
    return {
        "same_bytes": found.same,
        "agrees": not found.differences,
        "environment": list(found.environment),
        "differences": [{"name": each.name, "before": each.before, "after": each.after} for each in found.differences],
        "outputs": list(found.outputs),
    }
