"""`camcal rerun`: a report is calibrated again from the detections and options that it carries, and compared.

Two results agree if their figures differ by less than 1e-6 of their standard deviations.
"""

from collections.abc import Iterator, Mapping
from math import hypot, isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from camcal import files, records
from camcal.calibrate.rigs.record import Captures
from camcal.dataclass import dataclass, field, replace
from camcal.errors import CamcalError, GateFailed, InsufficientData, InvalidInput, Located, NotConverged
from camcal.formats import boards, documents, native
from camcal.formats.camera_file import STEP, CameraEntry, CameraFile
from camcal.messages import Message
from camcal.progress import SILENT, Progress
from camcal.report.page.thumbnails import PHOTO
from camcal.run.outputs import claim, writes
from camcal.targets.detection import BoardDetection, Detections
from camcal.tasks.calibration import calibrate as calibration
from camcal.tasks.calibration.board_views import BoardViews
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.file_options import RerunOptions
from camcal.tasks.reports import carried, pages
from camcal.tasks.reports.carried import CALIBRATE, PageData
from camcal.tasks.reports.closing import environment, environment_differences, result_text
from camcal.tasks.reports.pages import CAMERA_NAME, RIG_NAME
from camcal.tasks.rigs import calibrate_rig
from camcal.tasks.rigs.matching import Matched
from camcal.tasks.rigs.options import RigSettings
from camcal.tasks.rigs.rig_views import RigViews

REPORT_NAME = "report.html"
_FILES = (".html", ".yaml", ".yml", ".json")
EQUAL = 1e-6  # standard deviations
_FEW = 100.0  # degrees of freedom, where a file does not say them


@dataclass(frozen=True)
class Difference:
    """A figure that differs: its name, what it was and is, and the difference in standard deviations."""

    name: str
    before: str
    after: str
    sigmas: float = field(default=float("inf"), metadata=records.OMITTED)

    @property
    def line(self) -> str:
        """The difference in words."""
        how = f" ({self.sigmas:.2g} standard deviations)" if isfinite(self.sigmas) else ""
        return f"{self.name}: {self.before} in the report, {self.after} now{how}"


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
    """A page made again: its text, the text of the camera file, and why there is none."""

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
    data = carried.read(options.file, PHOTO)
    name = CAMERA_NAME if data.run["command"] == CALIBRATE else RIG_NAME
    output = options.output / REPORT_NAME
    refused = bool(data.run.get("refusal"))
    claim([output] if refused else [output, options.output / name])
    with Located(options.file):
        before = None if refused else parse_camera_file(data.run["result"], f"{options.file}: result")
        again = _calibrate_again(data, options, progress)
    files.write_text(output, again.page)
    same = files.read_bytes(options.file) == files.utf8(again.page)
    reason = data.run.get("refusal", "")
    found = [] if reason == again.refusal else [Difference("refusal", reason or "none", again.refusal or "none")]
    if before is not None and again.result:
        found = differences(before, parse_camera_file(again.result, name))
    recorded = {str(name): str(version) for name, version in data.run["environment"].items()}
    elsewhere = environment_differences(recorded, environment())
    written = (output,) if not again.result else (options.output / name, output)
    return Rerun(same, tuple(elsewhere), tuple(found), written)


def require_agreement(found: Rerun) -> None:
    """Raise GateFailed if figures differ."""
    if found.differences:
        values = {"figures": len(found.differences)}
        text = f"{len(found.differences)} figures differ by more than {EQUAL:g} standard deviations"
        raise GateFailed.of([Message("rerun_differs", text, values)])


def _calibrate_again(data: PageData, options: RerunOptions, progress: Progress) -> _Again:
    """Return the page made again; the camera or rig file is written to the folder."""
    again = _rerun_camera if data.run["command"] == CALIBRATE else _rerun_rig
    with TemporaryDirectory() as guesses:
        try:
            return again(data, options.output, Path(guesses), progress)
        except CamcalError as error:
            if error.where and error.where.startswith(guesses):
                error.where = f"{options.file}: --guess"
            raise


def _rerun_camera(data: PageData, folder: Path, guesses: Path, progress: Progress) -> _Again:
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
        return _Again(pages.refusal_text(seen, original.name, error, _now(run), data.photos), refusal=error.message)
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
    return _Again(pages.page_text(found, _now(run, text), data.photos), text)


def _rerun_rig(data: PageData, folder: Path, guesses: Path, progress: Progress) -> _Again:
    run = data.run
    original = carried.options_of(RigSettings, run["options"])
    guess = carried.unpacked_guesses(run, original, guesses)
    models = tuple(f"{name}={model}" for name, model in run["models"].items()) if "models" in run else original.models
    how = replace(original, output=folder / RIG_NAME, guess=tuple(guess), models=models, refine=None)
    seen = _captures(data)
    try:
        found = calibrate_rig.calibrated(lambda: seen, how, run["words"], progress)
    except (InsufficientData, NotConverged) as error:
        return _Again(pages.rig_refusal_text(seen, error, _now(run), data.photos), refusal=error.message)
    found = replace(
        found,
        warnings=carried.messages_of(run["warnings"]),
        lines=tuple(run["lines"]),
        refinement=carried.refinement_of(run.get("refinement")),
        candidates=carried.candidates_of(run["candidates"]) if "candidates" in run else found.candidates,
    )
    text = result_text(found.file, RIG_NAME)
    return _Again(pages.rig_page_text(found, _now(run, text), data.photos), text)


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
        "environment": found.environment,
        "differences": found.differences,
        "outputs": found.outputs,
    }


def parse_camera_file(text: str, where: str) -> CameraFile:
    """Return the content of the text of a camera file, without the joint covariance of a rig, which may be elsewhere.

    Raises InvalidInput or FileError as for a file.
    """
    document = documents.parse(text, where, native.check)
    data = {key: value for key, value in document.data.items() if key != "joint_covariance"}
    return native.from_document(documents.Document(where, data, document.lines), Path())


def differences(before: CameraFile, after: CameraFile) -> list[Difference]:
    """Return the figures that differ by more than EQUAL standard deviations, and what else differs."""
    return [*_camera_differences(before, after), *_transform_differences(before, after)]


def _camera_differences(before: CameraFile, after: CameraFile) -> Iterator[Difference]:
    if list(before.cameras) != list(after.cameras):
        yield Difference("cameras", ", ".join(before.cameras), ", ".join(after.cameras))
        return
    for name, old in before.cameras.items():
        yield from _entry_differences(name, old, after.cameras[name])


def _entry_differences(name: str, old: CameraEntry, new: CameraEntry) -> Iterator[Difference]:
    one, other = old.camera, new.camera
    if one.model.name != other.model.name or one.image_size != other.image_size:
        yield Difference(f"{name}: lens model", _lens(old), _lens(new))
        return
    for parameter in one.model.parameter_names:
        std = one.std(parameter) or 0.0
        yield from _figure_difference(f"{name}.{parameter}", one.value(parameter), other.value(parameter), std)
        yield from _figure_difference(f"{name}.{parameter} std", std, other.std(parameter) or 0.0, std)
    dof = _FEW if old.noise is None else float(old.noise.degrees_of_freedom or _FEW)
    for key in dict.fromkeys([*old.quality, *new.quality]):
        was, now = old.quality.get(key, float("nan")), new.quality.get(key, float("nan"))
        std = abs(was) / (2 * dof) ** 0.5 if key.endswith("_px") else 0.0
        yield from _figure_difference(f"{name}.{key}", was, now, std)
    if _verdict(old) != _verdict(new):
        yield Difference(f"{name}: verdict", _verdict(old), _verdict(new))


def _lens(entry: CameraEntry) -> str:
    return f"{entry.camera.model.name} {'x'.join(map(str, entry.camera.image_size))}"


def _verdict(entry: CameraEntry) -> str:
    return "unknown" if entry.verdict is None else "trustworthy" if entry.verdict.trustworthy else "not trustworthy"


def _transform_differences(before: CameraFile, after: CameraFile) -> Iterator[Difference]:
    if set(before.transforms) != set(after.transforms):
        yield Difference("transforms", ", ".join(before.transforms), ", ".join(after.transforms))
        return
    for name, old in before.transforms.items():
        new = after.transforms[name]
        stds = np.zeros(6) if old.covariance is None else np.sqrt(np.diag(old.covariance))
        step = (new.pose @ old.pose.inverse()).vector()
        moved = [*(new.pose.translation - old.pose.translation), *step]
        for axis, value, std in zip(STEP, moved, stds.tolist(), strict=True):
            yield from _figure_difference(f"{name}.{axis} change", 0.0, float(value), std)


def _figure_difference(name: str, was: float, now: float, std: float) -> Iterator[Difference]:
    """Yield a figure if it differs: by more than EQUAL of its std, or of its last digits where it has none."""
    apart = abs(now - was)
    limit = EQUAL * std if std > 0 else EQUAL * EQUAL * max(abs(was), EQUAL)
    if not apart <= limit + 1e-11 * hypot(was, now):
        yield Difference(name, f"{was:.12g}", f"{now:.12g}", apart / std if std > 0 else float("inf"))
