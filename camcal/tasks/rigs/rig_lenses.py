"""What is known of the lenses of a rig before the solve: models, given cameras and where these come from."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from camcal import files
from camcal.calibrate import intrinsics
from camcal.calibrate.fit import CalibrationFit, ShapeOptions
from camcal.calibrate.initialise import sweep_focal
from camcal.calibrate.intrinsics import Calibration, CandidateModel, FittedModel
from camcal.calibrate.rigs.record import Captures
from camcal.cameras.catalogue import DEFAULT_MODEL, WIDE_MODEL, model_named
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera, require_central
from camcal.cameras.observations import Observations
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.formats import cameras, split_address
from camcal.formats.camera_file import CameraFile
from camcal.messages import counted
from camcal.parsing import did_you_mean
from camcal.progress import SILENT, Progress
from camcal.quality.lens_choice import alternative, rank_models
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.mixed_sizes import usual_size
from camcal.tasks.calibration.model_selection import brief_calibration, compared, rank_beside
from camcal.tasks.given_camera import read_part, require_whole
from camcal.tasks.rigs.options import JOINT, PRIOR, RigSettings

_SIMILAR = 1.3  # ratio of rough focal lengths, up to which two cameras may be of a kind


@dataclass(frozen=True, eq=False)
class GivenLens:
    """The lens of a camera as a file gives it, and the hashes of the images that it was calibrated from."""

    camera: Camera
    where: str
    images: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class RigModels:
    """The lens model of every camera, others that predict alike, the models that were compared for cameras of a kind,
    by its cameras, and brief fits of cameras with their models. beside: the models that were asked for and the usual
    ones, in their order, by cameras.
    """

    models: Mapping[str, CameraModel]
    others: Mapping[str, CameraModel] = field(default_factory=dict)
    candidates: Mapping[tuple[str, ...], tuple[CandidateModel, ...]] = field(default_factory=dict)
    starts: Mapping[str, CalibrationFit] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    beside: Mapping[str, Sequence[CandidateModel]] = field(default_factory=dict)

    def candidates_of(self, name: str) -> Sequence[CandidateModel]:
        """Return the models that were compared for a camera, in their order, none where its lens is given."""
        if name in self.beside:
            return self.beside[name]
        found = next((compared for names, compared in self.candidates.items() if name in names), ())
        return rank_models(found, DEFAULT_MODEL)


def given_lenses(settings: RigSettings, names: Sequence[str], progress: Progress) -> dict[str, GivenLens]:
    """Return the lenses that --guess gives, by the names of cameras.

    Raises InvalidInput where a camera lacks one that --lenses needs, or its covariance; FileError.
    """
    found: dict[str, GivenLens] = {}
    if not settings.guess:
        require_whole(settings.part, "--guess CAMERA")
    for text in settings.guess:
        name, mark, address = text.partition("=")
        if mark and not Path(text).exists():
            _require_camera(name, names, text)
            path, own = split_address(address)
            file = _read(path, settings, progress)
            found[name] = _lens(file, own or (name if name in file.cameras else None), path)
        else:
            path, own = split_address(text)
            if own is not None:
                raise InvalidInput("one camera of a file is given as NAME=FILE#CAMERA", where=text)
            file = _read(path, settings, progress)
            known = [each for each in names if each in file.cameras]
            if not known:
                raise InvalidInput(
                    f"has the cameras {', '.join(file.cameras)}, the rig {', '.join(names)}: use --guess NAME=FILE",
                    where=str(path),
                )
            found |= {each: _lens(file, each, path) for each in known}
    _require_enough(found, settings, names)
    return found


def _read(path: Path, settings: RigSettings, progress: Progress) -> CameraFile:
    # a start may be poor; what is held at its value may not
    return read_part(path, settings.part, SILENT if settings.lenses == JOINT else progress)


def _require_camera(name: str, names: Sequence[str], where: str) -> None:
    if name not in names:
        raise InvalidInput(f"no camera {name!r} in the rig{did_you_mean(name, list(names))}", where=where)


def _lens(file: CameraFile, name: str | None, path: Path) -> GivenLens:
    entry = cameras.select(file, name, str(path))
    images = file.provenance.get("images")
    listed = [image for image in images if isinstance(image, Mapping)] if isinstance(images, list) else []
    own = [image for image in listed if image.get("camera", name) in (None, name) or len(file.cameras) == 1]
    return GivenLens(entry.camera, str(path), frozenset(str(each["sha256"]) for each in own if "sha256" in each))


def _require_enough(found: Mapping[str, GivenLens], settings: RigSettings, names: Sequence[str]) -> None:
    if settings.lenses == JOINT:
        return
    without = [name for name in names if name not in found]
    if without:
        raise InvalidInput(
            f"--lenses {settings.lenses}: no lens of camera {without[0]!r}: add --guess {without[0]}=FILE"
        )
    uncertain = [name for name, lens in found.items() if lens.camera.covariance is None]
    if settings.lenses == PRIOR and uncertain:
        where = found[uncertain[0]].where
        raise InvalidInput(
            f"the lens has no covariance: use --lenses fixed, or joint (camera {uncertain[0]})", where=where
        )


def starting(lens: Camera, model: CameraModel) -> Camera:
    """Return a lens as a start for a lens model: what the two have in common, other coefficients as they start."""
    if lens.model.name == model.name:
        return lens
    start = model.start(lens.image_size, lens.value("fx"))
    for index, name in enumerate(model.parameter_names):
        if name in lens.model.parameter_names:
            start[index] = lens.value(name)
    return Camera(model, lens.image_size, start)


def require_sizes(given: Mapping[str, GivenLens], captures: Captures) -> None:
    """Raise InvalidInput if a lens is for images of another size than those of its camera."""
    for name, lens in given.items():
        size = usual_size(_views(captures, name)) if name in captures.cameras else lens.camera.image_size
        if size != lens.camera.image_size:
            wrong, right = ("{}x{}".format(*each) for each in (lens.camera.image_size, size))
            raise InvalidInput(f"the lens is for {wrong} images, those of camera {name} are {right}", where=lens.where)


def require_other_images(given: Mapping[str, GivenLens], captures: Captures) -> None:
    """Raise InvalidInput if a lens was calibrated from images that the rig is calibrated from: as a prior it would
    count them twice.
    """
    for name, lens in given.items():
        views = _views(captures, name) if name in captures.cameras else []
        same = [view.image for view in views if (digest := _digest(view)) is not None and digest in lens.images]
        if same:
            raise InvalidInput(
                f"{counted(len(same), 'image')} of camera {name} ({Path(same[0]).name}, …) also made this calibration, "
                "and as a prior would count twice: use --lenses joint, or a calibration from other images",
                where=lens.where,
            )


def _digest(view: BoardDetection) -> str | None:
    if view.sha256 is None and Path(view.image).is_file():
        return files.sha256(Path(view.image))
    return view.sha256


def rig_models(
    captures: Captures,
    board: Board,
    settings: RigSettings,
    given: Mapping[str, GivenLens],
    shape: ShapeOptions,
    circles: Mapping[str, ImageCircle],
) -> RigModels:
    """Return the lens models: those of given lenses that are not estimated anew, those asked for, and for all other
    cameras what predicts their views best; circles: the image circles of those that have one.

    Raises InvalidInput for a model that does not exist, or not that of a lens that is held.
    """
    asked = _asked(settings.models, captures.cameras)
    models: dict[str, CameraModel] = {}
    for name, lens in given.items():
        if settings.lenses == JOINT:
            continue
        if name in asked and asked[name] != lens.camera.model.name:
            raise InvalidInput(
                f"--model {asked[name]}: --lenses {settings.lenses} has {lens.camera.model.name}", where=lens.where
            )
        models[name] = lens.camera.model
    models = {name: model_named(model) for name, model in asked.items()} | models
    open_ = [name for name in captures.cameras if name not in models]
    found = _chosen_for(captures, board, open_, shape, circles)
    estimated = {name: models[name] for name in asked if name not in given or settings.lenses == JOINT}
    beside = _compare_asked(captures, board, estimated, shape, circles)
    return RigModels(
        {name: {**models, **found.models}[name] for name in captures.cameras},
        found.others,
        found.candidates,
        {**found.starts, **_starts(beside, models)},
        found.lines,
        beside,
    )


def _starts(
    compared: Mapping[str, Sequence[CandidateModel]], models: Mapping[str, CameraModel]
) -> dict[str, CalibrationFit]:
    """Return the brief fits of cameras with their models, among those that were compared."""
    return {
        name: own.fit
        for name, candidates in compared.items()
        for own in candidates
        if own.name == models[name].name and isinstance(own, FittedModel) and own.fit is not None
    }


def brief_lenses(
    captures: Captures, board: Board, settings: RigSettings, shape: ShapeOptions, circles: Mapping[str, ImageCircle]
) -> dict[str, Calibration]:
    """Return brief calibrations of cameras alone, by which corners can be expected, of those whose views hold one."""
    asked, result = _asked(settings.models, captures.cameras), dict[str, Calibration]()
    for name in captures.cameras:
        options = intrinsics.Options(model_named(asked.get(name, DEFAULT_MODEL)), shape=shape)
        views, circle = _views(captures, name), circles.get(name)
        with suppress(InsufficientData, InvalidInput):
            found = brief_calibration(views, board, options, circle, choose=name not in asked)
            result |= {name: found} if found is not None else {}
    return result


def _compare_asked(
    captures: Captures,
    board: Board,
    models: Mapping[str, CameraModel],
    shape: ShapeOptions,
    circles: Mapping[str, ImageCircle],
) -> dict[str, list[CandidateModel]]:
    """Return the models that cameras were given and the usual ones, in their order, of views that hold a lens."""
    found = {}
    for name, model in models.items():
        views, options = _views(captures, name), intrinsics.Options(model, shape=shape)
        with suppress(InsufficientData, InvalidInput):
            [own] = intrinsics.compare_models(views, board, options, [model])
            found[name] = rank_beside(own, views, board, options, circles.get(name))
    return found


def _asked(texts: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Return the names of the models that are asked for, by cameras."""
    found: dict[str, str] = {}
    for text in texts:
        name, mark, model = text.partition("=")
        if not mark:
            found = {each: model_named(text).name for each in names} | found
        else:
            _require_camera(name, names, f"--model {text}")
            found[name] = model_named(model).name
        require_central(model_named(model or text))
        if model_named(model or text).configuration:
            raise InvalidInput(
                f"--model {text}: a spline is calibrated by camcal calibrate, and taken over by --lenses fixed"
            )
    return found


def _views(captures: Captures, name: str) -> list[BoardDetection]:
    index = captures.cameras.index(name)
    return [view for view in captures.of(index) if view is not None]


def _chosen_for(
    captures: Captures,
    board: Board,
    names: Sequence[str],
    shape: ShapeOptions,
    circles: Mapping[str, ImageCircle],
) -> RigModels:
    """Return the models that predict the views of cameras best, one for all cameras of a kind.

    Of a kind are cameras with images of one size and similar focal lengths for which one model does. A camera whose
    views do not hold a lens gets the usual one.
    """
    options = intrinsics.Options(model_named(DEFAULT_MODEL), shape=shape)
    found: dict[str, tuple[CandidateModel, ...]] = {}
    by_size: dict[tuple[int, int], list[str]] = defaultdict(list)
    for name in names:
        views = _views(captures, name)
        with suppress(InsufficientData, InvalidInput):
            found[name] = compared(views, board, options, circles.get(name))
            by_size[usual_size(views)].append(name)
    focals = {name: _focal(_views(captures, name), board) for name in found}
    groups = [group for names in by_size.values() for group in _similar(names, focals)]
    kinds = [kind for group in groups for kind in _kinds(group, found)]
    models = dict.fromkeys(names, model_named(DEFAULT_MODEL))
    models |= {name: model_named(kind.model) for kind in kinds for name in kind.names}
    alike = [(kind.names, alternative(kind.candidates, kind.model)) for kind in kinds]
    others = {name: model_named(other.name) for own, other in alike if other is not None for name in own}
    lines = tuple(kind.line for kind in kinds if kind.model != DEFAULT_MODEL)
    compared_of = {kind.names: kind.candidates for kind in kinds}
    return RigModels(models, others, compared_of, _starts(found, models), lines)


def _focal(views: Sequence[BoardDetection], board: Board) -> float:
    """Return a rough focal length, px, whatever the lens; 0 where there is none."""
    usable = [view for view in views if view.found and view.size == usual_size(views)]
    state = sweep_focal(model_named(WIDE_MODEL), board, Observations.of(usable), usable[0].size)
    return 0.0 if state is None else float(state.parameters[0])


def _similar(names: Sequence[str], focals: Mapping[str, float]) -> list[list[str]]:
    """Return cameras in groups of similar focal lengths, in the order of the cameras."""
    groups: list[list[str]] = []
    for name in sorted(names, key=lambda name: focals[name]):
        if groups and focals[name] <= _SIMILAR * focals[groups[-1][-1]]:
            groups[-1].append(name)
        else:
            groups.append([name])
    return [[name for name in names if name in group] for group in groups]


@dataclass(frozen=True, eq=False)
class _Kind:
    """Cameras with one lens model, and the models that were compared for them."""

    names: tuple[str, ...]
    candidates: tuple[CandidateModel, ...]
    model: str

    @property
    def line(self) -> str:
        """The line of the report on another model than the usual one."""
        scores = {own.name: own for own in self.candidates}
        default, taken = scores.get(DEFAULT_MODEL), scores[self.model]
        words = f"lens model of {', '.join(self.names)}: {self.model}"
        if default is None or default.scores is None:
            return f"{words}; {DEFAULT_MODEL} failed"
        errors = f"{taken.sigma_px:.2g} px, {DEFAULT_MODEL} {default.sigma_px:.2g} px"
        return f"{words}; prediction error of left-out views {errors}"


def _kinds(names: Sequence[str], found: Mapping[str, tuple[CandidateModel, ...]]) -> list[_Kind]:
    """Return cameras by their kinds: one for which another model than the common one predicts clearly better, such as a
    fisheye beside a narrow lens, is of another kind.
    """
    joint = together([found[name] for name in names])
    model = rank_models(joint, DEFAULT_MODEL)[0].name
    # by prediction and failures alone: of one model for a kind, what is known of each lens is no reason to give it up
    alone = {name: [replace(own, map_px=None) for own in found[name]] for name in names}
    others = [name for name in names if rank_models(alone[name], model)[0].name != model]
    if not others or len(names) == 1:
        return [_Kind(tuple(names), joint, model)]
    same = [name for name in names if name not in others]
    parts = [same, others] if same else [[name] for name in names]
    return [kind for part in parts for kind in _kinds(part, found)]


def together(candidates: Sequence[Sequence[CandidateModel]]) -> tuple[CandidateModel, ...]:
    """Return the models that were compared for every one of some cameras, with the scores of all their views."""
    by_name = [{own.name: own for own in each} for each in candidates]
    names = [name for name in by_name[0] if all(name in each for each in by_name)]
    return tuple(_join([each[name] for each in by_name]) for name in names)


def _join(candidates: Sequence[CandidateModel]) -> CandidateModel:
    """Return a model with its scores of all cameras, without any where it failed for one of them."""
    failed = next((own for own in candidates if own.scores is None), None)
    if failed is not None:
        return CandidateModel(failed.name, reason=failed.reason)
    corners = [own.corners for own in candidates]
    variances = np.array([own.sigma_px or 0.0 for own in candidates]) ** 2
    return CandidateModel(
        candidates[0].name,
        np.concatenate([own.scores for own in candidates if own.scores is not None]),
        sum(corners),
        float(np.sqrt(np.average(variances, weights=corners))),
        map_px=float(np.sqrt(np.mean([(own.map_px or 0.0) ** 2 for own in candidates]))),
        failures=tuple(sorted({code for own in candidates for code in own.failures})),
    )
