"""Lenses as a format can write them: exactly, or the nearest that it has, within what the user accepts."""

import math
from collections.abc import Iterator, Mapping
from math import ceil, floor, isfinite, log10
from typing import TYPE_CHECKING

import numpy as np

from camcal.arrays import FloatArray
from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.cameras.refit import same_lens
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.formats.camera_file import CameraEntry, CameraFile, ValidRegion, with_cameras
from camcal.formats.cameras.record import CameraFormat, expressed, lost_coefficients

if TYPE_CHECKING:
    from camcal.cameras.refit import Refit, Region

USUAL_ERROR_PX = 0.1  # of a lens that is to be of another model
_PARTS = (85.0, 75.0, 60.0, 45.0)  # degrees from the axis, where no lens is near over the whole image
_NEAR_PX = 1.0  # off by less than this a lens is worth being named
_ROUNDING = 1e-9
_AROUND = 72  # directions in which the edge of what is near is looked at


@dataclass(frozen=True)
class Nearest:
    """What may be written where a format does not have a lens, or another model is wanted.

    model: the lens model that lenses are to have, None: their own where the format has it. max_error_px: how far off
    the nearest lens may be anywhere, None: USUAL_ERROR_PX where a model is wanted, otherwise lenses have to be exact.
    max_theta: rad, up to which angle from the axis it has to be near.
    """

    model: str | None = None
    max_error_px: float | None = None
    max_theta: float = math.inf

    @property
    def accepted_px(self) -> float | None:
        """How far off a lens may be; None where it has to be exact."""
        return USUAL_ERROR_PX if self.max_error_px is None and self.model is not None else self.max_error_px


EXACT = Nearest()


@dataclass(frozen=True, eq=False)
class Prepared:
    """A camera file with lenses that a format has; refits: by the names of cameras, those that are not exact."""

    file: CameraFile
    refits: Mapping[str, "Refit"]


def prepared(file: CameraFile, form: CameraFormat, where: str, nearest: Nearest = EXACT) -> Prepared:
    """Return a camera file with its lenses as a format can write them: exactly, or the nearest that is accepted.

    Raises InvalidInput, saying what would be lost and what to do, for more cameras than it holds, and for a lens that
    none of its models is.
    """
    if form.most_cameras is not None and len(file.cameras) > form.most_cameras:
        names = ", ".join(file.cameras)
        most = f"{form.most_cameras} camera{'s' * (form.most_cameras > 1)}"
        raise InvalidInput(f"{form.title} holds {most}, not {names}: write them one by one, FILE#NAME", where=where)
    refits: dict[str, Refit] = {}
    changed: dict[str, tuple[Camera, FloatArray]] = {}
    entries = dict(file.cameras)
    for name, entry in file.cameras.items():
        camera = _exact(entry.camera, form, nearest.model)
        if camera is None:
            refits[name] = _nearest(entry, name, form, nearest, where)
            changed[name] = refits[name].camera, refits[name].jacobian
        else:
            entries[name] = replace(entry, camera=camera)
    file = with_cameras(replace(file, cameras=entries), changed)
    limited = isfinite(nearest.max_theta)
    entries = {name: _refitted(entry, refits.get(name), limited=limited) for name, entry in file.cameras.items()}
    file = replace(file, cameras=entries)
    return Prepared(replace(file, converted_from=_origin(file, refits)) if refits else file, refits)


def _refitted(entry: CameraEntry, found: "Refit | None", *, limited: bool) -> CameraEntry:
    """Return a camera with what is known of it as a refit leaves that; limited: near up to an angle only."""
    if found is None:
        return entry
    circle = _lit(entry, found, limited=limited)
    valid = ValidRegion.of(entry.camera, circle)
    theta = min(found.max_theta, valid.max_theta or math.inf)
    polygon = entry.valid.polygon if entry.valid is not None else None
    return replace(entry, valid=replace(valid, max_theta=theta, polygon=polygon), held_by_prior=())


def _lit(entry: CameraEntry, found: "Refit", *, limited: bool) -> ImageCircle | None:
    """Return the image circle of a camera; of one that is near up to an angle only, the disc within that angle."""
    if not limited:
        return entry.image_circle
    turns = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    across = np.column_stack([np.cos(turns), np.sin(turns)]) * np.sin(found.max_theta)
    edge = found.camera.project(np.column_stack([across, np.full(_AROUND, np.cos(found.max_theta))])).pixels
    centre = (found.camera.value("cx"), found.camera.value("cy"))
    disc = ImageCircle(found.camera.image_size, centre, float(np.nanmin(np.hypot(*(edge - centre).T))))
    known = entry.image_circle
    return known if known is not None and known.radius < disc.radius else disc


def _origin(file: CameraFile, refits: Mapping[str, "Refit"]) -> dict[str, object]:
    """Return where the lenses of a file come from, and how far the refitted ones are off."""
    figures = {
        "refit_rms_px": max(found.rms_px for found in refits.values()),
        "refit_max_px": max(found.max_px for found in refits.values()),
    }
    return {"file": "camera", "format": "camcal", **file.converted_from, "exact": False, **figures}


def _exact(camera: Camera, form: CameraFormat, wanted: str | None) -> Camera | None:
    """Return a camera in the lens model that a format writes it as, None if that has none which is the same.

    wanted: the lens model that it is to have, None for any.
    """
    if camera.model.name == wanted:
        return camera
    for same in same_lens(camera):
        if wanted is not None:
            models: tuple[str, ...] = (wanted,)
        elif form.lenses is None:
            models = form.models
        else:
            row = form.lenses.row(same)
            models = () if row is None else (row.model, *form.models)
        found = expressed(same, models)
        if found is not None:
            return found
    return None


def _nearest(entry: CameraEntry, name: str, form: CameraFormat, nearest: Nearest, where: str) -> "Refit":
    """Return the nearest lens that a format has, or that is wanted; raises InvalidInput if it is not accepted."""
    from camcal.cameras.refit import Region

    if entry.camera.model.is_view:
        what = f"{name}: {entry.camera.model.name} cannot be written to {form.title}"
        raise InvalidInput(f"{what}, whose lens models are {', '.join(form.models)}", where=where)
    known = entry.valid.max_theta if entry.valid is not None else None
    limit = min(nearest.max_theta, math.inf if known is None else known * (1 + _ROUNDING))
    region = Region(entry.image_circle, limit)
    found = _best(entry.camera, form, nearest.model, region)
    accepted = nearest.accepted_px
    if found is not None and accepted is not None and found.max_px <= accepted:
        return found
    said = ""
    if found is None or not isfinite(found.max_px):
        tries = (replace(region, max_theta=math.radians(theta)) for theta in _PARTS if math.radians(theta) < limit)
        parts = (_best(entry.camera, form, nearest.model, part) for part in tries)
        found = next((part for part in parts if part is not None and part.max_px < _NEAR_PX), None)
        said = "" if found is None else f" --max-theta {math.degrees(found.max_theta):.0f}"
    raise InvalidInput(f"{name}: {_refusal(entry.camera, found, form, nearest, said)}", where=where)


def _refusal(camera: Camera, found: "Refit | None", form: CameraFormat, nearest: Nearest, part: str) -> str:
    """Return what nearest lens was found, None for none, and the ways out; part: the option by which it is near."""
    alike = any(type(MODELS[name]) is type(camera.model) for name in form.models)
    lost = ", ".join(f"{key} = {value:.4g}" for key, value in lost_coefficients(camera, form.models).items() if alike)
    has = (
        f"{form.title} has no lens model with {lost}" if lost else f"{form.title} has no lens model {camera.model.name}"
    )
    said = [] if nearest.model is not None else [has]
    ways = ["undistort the images ('camcal undistort') and give the camera that it writes"]
    ways += ["give a table ('camcal undistort --maps')"]
    if found is not None:
        model, theta = found.camera.model.name, math.degrees(found.max_theta)
        ways[:0] = [f"accept it with --max-error {_above(found.max_px)}{part}"]
        ways[1:1] = [] if part else [f"calibrate with --model {model}"]
        said.append(f"the nearest {model} is off by up to {found.max_px:.3g} px ({found.rms_px:.2g} px RMS)")
        said[-1] += f" up to {theta:.0f}° from the axis" if part else ""
    elif nearest.model is not None:
        said.append(f"no {nearest.model} is near this lens")
    return f"{'; '.join(said)}: {', '.join(ways[:-1])}, or {ways[-1]}"


def _best(camera: Camera, form: CameraFormat, wanted: str | None, region: "Region") -> "Refit | None":
    """Return the nearest lens of the model that is wanted, or of those of a format; None where there is none."""
    fits = _fits(camera, form, wanted, region)
    return min(fits, key=lambda own: (own.max_px, own.rms_px), default=None)


def _fits(camera: Camera, form: CameraFormat, wanted: str | None, region: "Region") -> Iterator["Refit"]:
    """Yield the nearest lens of the model that is wanted, or of each kind that a format has."""
    from camcal.cameras.refit import refit

    for model in [model_named(wanted)] if wanted is not None else _richest(form, type(camera.model)):
        try:
            yield refit(camera, model, region)
        except InsufficientData:
            continue


def _richest(form: CameraFormat, kind: type[CameraModel]) -> list[CameraModel]:
    """Return the lens model of most parameters that a format has of a kind, or of each kind where it has none of that.

    Views are no lenses.
    """
    models = [MODELS[name] for name in form.models if not MODELS[name].is_view]
    kinds = {type(model): [each for each in models if type(each) is type(model)] for model in models}
    chosen = [kinds[kind]] if kind in kinds else list(kinds.values())
    return [max(own, key=lambda each: len(each.parameter_names)) for own in chosen]


def _above(value: float) -> str:
    """Return a number of two digits that is not below a value."""
    scale = 10.0 ** (floor(log10(value)) - 1)
    return f"{ceil(value / scale) * scale:.2g}"
