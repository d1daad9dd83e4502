"""The blocks of a camera file: a camera with all that is known of it, and the shape of the board it was calibrated on.

The lens of a camera has a model's parameters by name, which of them were held, how well the others are known:

    intrinsics: {fx: 458.654, fy: 457.296, cx: 367.215, cy: 248.375}
    distortion: {k1: -0.28340811, k2: 0.07395907, p1: 0.00019359, p2: 1.76187114e-05, k3: 0.0}
    fixed: [k3]
    uncertainty: {std: {fx: 0.41, ...}, covariance_order: [fx, ...], covariance: [[...], ...]}

The shape of a board:

    board: {type: chessboard, inner_corners: [9, 6], square_mm: 25.0}
    classes:                              # optional
      bow: {scale: 0.00039, std: 0.0001}
    coefficients: {xy: 1.2e-05, P2(x): 0.00021, P2(y): -3.1e-05, stretch: -0.003, shear: 1.0e-05}
    uncertainty: {std: {xy: 2.0e-06, ...}, covariance_order: [...], covariance: [...]}
    deflection_m: 0.00031
    deflection_std_m: 1.5e-05
    offsets: one [x, y, z] per corner, in the order of the ids (optional)
    tiers: [bow, stretch]                 # optional, in older files

Coefficients, offsets and deflection are in metres, in squares when the square's size is unknown (the keys then end in
_squares); stretch and shear are ratios. Scales are shares of the board's longer side, ratios for stretch and shear.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal.cameras.catalogue import MODELS, model_of
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import InvalidInput
from camcal.formats import boards, covariance
from camcal.formats.camera_file import CalibrationNoise, CalibrationVerdict, CameraEntry, ProjectionStd, ValidRegion
from camcal.formats.documents import Check, Fault, child
from camcal.formats.schema import (
    FOCAL_LENGTH,
    LARGEST_SIDE,
    STD,
    VENDOR,
    flag,
    integer,
    items,
    mapping,
    number,
    one_of,
    plain,
    text,
    unchecked,
)
from camcal.parsing import did_you_mean, nearest
from camcal.quality.projection_uncertainty import KnownRegion
from camcal.targets.board import CLASSES, CORNER_CLASSES, OFFSETS, SCALE, TERMS, TIERS, Surface

FIGURES = ("rms_px", "mean_px", "median_px", "p95_px", "max_px", "chi2_per_degree")
COUNTS = ("images_used", "images_total", "points_used", "points_total", "points_rejected")
VALID: Mapping[str, Check] = {
    "max_theta_deg": number(0, 180),
    "max_radius_px": number(positive=True),
    "polygon": items(items(number(), 2)),
    "image_circle": mapping({"centre_px": items(number(), 2), "radius_px": number(positive=True)}),
}
SENSOR: Mapping[str, Check] = {
    "pixel_pitch_um": number(positive=True),
    "gain_e_per_dn": number(positive=True),
    "read_noise_e": number(0),
    "full_well_e": number(positive=True),
    "black_level_dn": number(0),
    "bits": integer(1, 64),
}
# Row y of H of an image is taken at stamp + offset + rate · (stamp - reference) + readout · y / H.
TIMING: Mapping[str, Check] = {
    **dict.fromkeys(("offset_s", "rate", "reference_s", "readout_s", "middle_offset_s"), number()),
    **dict.fromkeys(("offset_std_s", "rate_std", "readout_std_s", "middle_offset_std_s"), number(0)),
}
CORE = ("fx", "fy", "cx", "cy", "skew")  # named under intrinsics; all others are named under distortion
PROJECTION_FIGURES = ("centre_px", "rms_px", "median_px", "p95_px", "max_px", "inside_rms_px", "inside_max_px")

_FOCAL = ("fx", "fy")
_UNCERTAINTY = mapping(
    {},
    {
        **covariance.KEYS,
        "projection": items(
            mapping({}, {"range_m": number(positive=True), **dict.fromkeys(PROJECTION_FIGURES, number(0))})
        ),
        "boards": covariance.BOARDS,
    },
)

# A key of the file is a plain word.
KEY_OF_TERM = {term: {"x/y scale": "stretch"}.get(term, term.replace(" ", "_")) for term in (*TERMS, SCALE)}
KEY_OF_CLASS = {name: name.replace(" ", "_") for name in (*CLASSES, *CORNER_CLASSES)}
_TERM_OF_KEY = {key: term for term, key in KEY_OF_TERM.items()}
_CLASS_OF_KEY = {key: name for name, key in KEY_OF_CLASS.items()}

_SCALE = mapping({"scale": number(0), "std": STD})
_SHAPE = mapping(
    {
        "board": boards.check,
        "coefficients": mapping({}, dict.fromkeys(_TERM_OF_KEY, number())),
        "uncertainty": mapping({}, covariance.KEYS),
    },
    {
        "tiers": items(one_of((*TIERS, OFFSETS), "tier")),
        "classes": mapping({}, dict.fromkeys(_CLASS_OF_KEY, _SCALE)),
        **{f"{what}_{unit}": number(0) for what in ("deflection", "deflection_std") for unit in ("m", "squares")},
        "offsets": items(items(number(), 3)),
    },
)


def _model(value: Any, path: str) -> Iterator[Fault]:
    if not isinstance(value, str) or value not in MODELS:
        yield from one_of(tuple(MODELS), "model")(value, path)


_REGION = mapping(
    {"limit_px": number(positive=True), "share": number(0, 1), "polygon": items(items(number(), 2))},
    {"of_observed": number(0, 1)},
)
_LENS = dict.fromkeys(("distortion", "fixed", "uncertainty"), unchecked)  # `_check_lens` looks at it
_ENTRY = mapping(
    {"image_size": items(integer(1, LARGEST_SIDE), 2), "model": _model, "intrinsics": unchecked},
    {
        **_LENS,
        "configuration": plain,
        "held_by_prior": unchecked,
        "valid": mapping({}, VALID),
        "quality": mapping({}, {**dict.fromkeys(FIGURES, number(0)), **dict.fromkeys(COUNTS, integer(0))}),
        "noise": mapping({"sigma_px": number(0)}, {"degrees_of_freedom": integer(1), "model_error_px": number(0)}),
        "verdict": mapping({"trustworthy": flag}, {"reasons": items(text), "region": _REGION}),
        "sensor": mapping({}, SENSOR),
        "timing": mapping({}, TIMING),
        "channels": mapping({}, others=mapping({"intrinsics": unchecked}, _LENS)),
    },
)


def check(data: Any, path: str) -> Iterator[Fault]:
    """Check one camera."""
    yield from _ENTRY(data, path)
    name = data.get("model") if isinstance(data, dict) else None
    if not isinstance(name, str) or name not in MODELS:
        return
    try:
        model = model_of(name, data.get("configuration"))
    except InvalidInput as error:
        yield Fault(child(path, "configuration"), error.message)
        return
    yield from _check_lens(data, path, model)
    yield from _check_held_by_prior(data, path, model)
    channels = data.get("channels")
    for colour, lens in channels.items() if isinstance(channels, dict) else ():
        if isinstance(lens, dict):
            yield from _check_lens(lens, child(child(path, "channels"), colour), model)


def read(data: Mapping[str, Any], folder: Path) -> tuple[CameraEntry, tuple[str, ...]]:
    """Return the entry of data that has passed `check`, and the parameters that lack an uncertainty others have."""
    model, size = model_of(data["model"], data.get("configuration")), (data["image_size"][0], data["image_size"][1])
    camera, unknown = _read_lens(data, model, size, folder)
    channels = {name: _read_lens(lens, model, size, folder)[0] for name, lens in data.get("channels", {}).items()}
    return CameraEntry(
        camera,
        valid=_read_valid(data["valid"], size) if "valid" in data else None,
        projection=tuple(map(_read_projection, data.get("uncertainty", {}).get("projection", ()))),
        quality=data.get("quality", {}),
        noise=CalibrationNoise(**data["noise"]) if "noise" in data else None,
        verdict=_read_verdict(data["verdict"]) if "verdict" in data else None,
        sensor=data.get("sensor", {}),
        timing={key: float(value) for key, value in data.get("timing", {}).items()},
        channels=channels,
        held_by_prior=tuple(data.get("held_by_prior", ())),
        boards=covariance.read_boards(data.get("uncertainty", {}), camera),
        extra={key: value for key, value in data.items() if key.startswith(VENDOR)},
    ), unknown


def _read_valid(data: Mapping[str, Any], image_size: tuple[int, int]) -> ValidRegion:
    theta = math.radians(data["max_theta_deg"]) if "max_theta_deg" in data else None
    known = data.get("image_circle")
    circle = None
    if known is not None:
        x, y = map(float, known["centre_px"])
        circle = ImageCircle(image_size, (x, y), float(known["radius_px"]))
    return ValidRegion(theta, data.get("max_radius_px"), data.get("polygon"), circle)


def _read_projection(data: Mapping[str, Any]) -> ProjectionStd:
    figures = {name: float(value) for name, value in data.items() if name != "range_m"}
    return ProjectionStd(figures, data.get("range_m"))


def _read_verdict(data: Mapping[str, Any]) -> CalibrationVerdict:
    region = None
    if "region" in data:
        own = data["region"]
        region = KnownRegion(own["limit_px"], own["share"], own.get("of_observed", 1.0), np.array(own["polygon"]))
    return CalibrationVerdict(data["trustworthy"], tuple(data.get("reasons", ())), region)


def block(entry: CameraEntry, beside: Path) -> dict[str, Any]:
    """Return the data of one camera; beside: the file it is for."""
    camera = entry.camera
    data: dict[str, Any] = {"image_size": list(camera.image_size), "model": camera.model.name}
    data["configuration"] = camera.model.configuration or None
    data.update(_lens_block(camera, beside))
    data["held_by_prior"] = list(entry.held_by_prior) or None
    if entry.projection:
        data.setdefault("uncertainty", {})["projection"] = [
            {"range_m": item.range_m, **item.figures} for item in entry.projection
        ]
    if entry.boards is not None and "covariance_order" in data.get("uncertainty", {}):
        uncertainty = data["uncertainty"]
        uncertainty["boards"] = covariance.boards_block(entry.boards, uncertainty["covariance_order"], camera)
    data["valid"] = _valid_block(entry.valid) if entry.valid else None
    data["quality"] = entry.quality or None
    data["noise"] = vars(entry.noise) if entry.noise else None
    data["verdict"] = _verdict_block(entry.verdict) if entry.verdict else None
    data["sensor"] = entry.sensor or None
    data["timing"] = entry.timing or None
    data["channels"] = {name: _lens_block(lens, beside) for name, lens in entry.channels.items()} or None
    return {**data, **entry.extra}


def _verdict_block(verdict: CalibrationVerdict) -> dict[str, Any]:
    region = verdict.region and vars(verdict.region) | {"polygon": verdict.region.polygon.round(2).tolist()}
    return {"trustworthy": verdict.trustworthy, "reasons": verdict.reasons, "region": region}


def _valid_block(valid: ValidRegion) -> dict[str, Any]:
    return {
        "max_theta_deg": None if valid.max_theta is None else math.degrees(valid.max_theta),
        "max_radius_px": valid.max_radius_px,
        "polygon": None if valid.polygon is None else valid.polygon.tolist(),
        "image_circle": circle_block(valid.image_circle),
    }


def circle_block(circle: ImageCircle | None) -> dict[str, Any] | None:
    """Return an image circle as plain data."""
    return None if circle is None else {"centre_px": list(circle.centre), "radius_px": circle.radius}


def _check_lens(block: Mapping[str, Any], path: str, model: CameraModel) -> Iterator[Fault]:
    """Check the keys of a lens of the given model; other keys of the block are not examined."""
    names = model.parameter_names
    yield from _check_names(block.get("intrinsics", {}), child(path, "intrinsics"), model, _core(names))
    yield from _check_names(block.get("distortion", {}), child(path, "distortion"), model, _distortion(names))
    fixed = block.get("fixed", [])
    yield from items(one_of(names, "parameter"))(fixed, child(path, "fixed"))
    uncertainty, where = block.get("uncertainty", {}), child(path, "uncertainty")
    faults = list(_UNCERTAINTY(uncertainty, where))
    yield from faults or covariance.check(uncertainty, where, names, fixed if isinstance(fixed, list) else ())
    yield from [] if faults else covariance.check_boards(uncertainty, where)


def _check_held_by_prior(block: Mapping[str, Any], path: str, model: CameraModel) -> Iterator[Fault]:
    """Check the names of coefficients that a prior holds: some of the model's that were not fixed."""
    held, fixed = block.get("held_by_prior", []), block.get("fixed", [])
    where = child(path, "held_by_prior")
    faults = list(items(one_of(_distortion(model.parameter_names), "coefficient"))(held, where))
    yield from faults
    for index, name in enumerate([] if faults else held):
        if name in held[:index]:
            yield Fault(child(where, index), f"{name!r} occurs twice")
        elif isinstance(fixed, list) and name in fixed:
            yield Fault(child(where, index), f"{name!r} is fixed and cannot have a prior; leave it out")


def _core(names: Sequence[str]) -> list[str]:
    return [name for name in names if name in CORE]


def _distortion(names: Sequence[str]) -> list[str]:
    return [name for name in names if name not in CORE]


def _check_names(values: Any, path: str, model: CameraModel, names: Sequence[str]) -> Iterator[Fault]:
    """Check that values are named as the model needs them, no more and no fewer."""
    if not isinstance(values, dict):
        yield from mapping({})(values, path)
        return
    missing = [name for name in names if name not in values]
    misspelt: set[str | None] = set()
    for name, value in values.items():
        if name in names:
            yield from (FOCAL_LENGTH if name in _FOCAL else number(*model.limits[name]))(value, child(path, name))
        else:
            misspelt.add(nearest(name, missing))
            yield Fault(child(path, name), f"model {model.name!r} has no {name!r} here{did_you_mean(name, missing)}")
    missing = [name for name in missing if name not in misspelt]
    if missing:
        lacks = f"model {model.name!r} needs {','.join(names)}; missing {', '.join(map(repr, missing))}"
        yield Fault(path, lacks if missing[0] in CORE else f"{lacks} (write {missing[0]}: 0.0)")


def _read_lens(
    block: Mapping[str, Any], model: CameraModel, image_size: tuple[int, int], folder: Path
) -> tuple[Camera, tuple[str, ...]]:
    """Return the camera of a block that has passed `check`, and the parameters that have no uncertainty beside others
    that do.
    """
    values = {**block["intrinsics"], **block.get("distortion", {})}
    parameters = np.array([float(values[name]) for name in model.parameter_names])
    fixed = tuple(block.get("fixed", ()))
    uncertainty = block.get("uncertainty", {})
    if not {"std", "covariance_order"} & uncertainty.keys():
        return Camera(model, image_size, parameters, fixed=fixed), ()
    known, unknown = covariance.read(uncertainty, model.parameter_names, folder, fixed)
    return Camera(model, image_size, parameters, known, fixed), unknown


def _lens_block(camera: Camera, beside: Path) -> dict[str, Any]:
    """Return the block of a camera's lens; beside: the file it is for."""
    names = camera.model.parameter_names
    values = dict(zip(names, camera.parameters.tolist(), strict=True))
    data: dict[str, Any] = {"intrinsics": {name: values[name] for name in _core(names)}}
    if distortion := _distortion(names):
        data["distortion"] = {name: values[name] for name in distortion}
    if camera.fixed:
        data["fixed"] = list(camera.fixed)
    if camera.covariance is not None:
        data["uncertainty"] = covariance.block(names, camera.covariance, beside, camera.fixed)
    return data


def check_board_shape(data: Any, path: str) -> Iterator[Fault]:
    """Check the shape of a board."""
    faults = list(_SHAPE(data, path))
    yield from faults
    if faults:
        return
    board, terms = boards.from_block(data["board"]), _terms(data)
    yield from covariance.check(data["uncertainty"], child(path, "uncertainty"), terms)
    lacking = [name for name in terms if name not in data["uncertainty"].get("std", {})]
    if lacking:
        yield Fault(child(path, "uncertainty"), f"std is missing for {', '.join(lacking)}")
    other = "squares" if board.unit == "m" else "m"
    for key in (f"deflection_{other}", f"deflection_std_{other}"):
        if key in data:
            yield Fault(child(path, key), f"the board's lengths are in {board.unit}; write deflection_{board.unit}")
    if "offsets" in data and len(data["offsets"]) != board.count:
        yield Fault(child(path, "offsets"), f"{len(data['offsets'])} offsets; the board has {board.count} corners")


def read_board_shape(data: Mapping[str, Any], folder: Path) -> Surface:
    """Return the surface of data that has passed `check`."""
    board, keys = boards.from_block(data["board"]), _terms(data)
    known, _ = covariance.read(data["uncertainty"], keys, folder)
    return Surface(
        board,
        tuple(data.get("tiers", ())),
        terms=tuple(_TERM_OF_KEY[key] for key in keys),
        coefficients=np.array([float(data["coefficients"][key]) for key in keys]),
        covariance=np.zeros((0, 0)) if known is None else known,
        offsets=np.array(data["offsets"], dtype=float) if "offsets" in data else None,
        deflection=float(data.get(f"deflection_{board.unit}", 0.0)),
        deflection_std=float(data.get(f"deflection_std_{board.unit}", 0.0)),
        classes={
            _CLASS_OF_KEY[key]: (float(found["scale"]), float(found["std"]))
            for key, found in data.get("classes", {}).items()
            if key in _CLASS_OF_KEY  # and not x_ keys of others
        },
    )


def _terms(data: Mapping[str, Any]) -> list[str]:
    return [key for key in data["coefficients"] if key in _TERM_OF_KEY]


def board_shape_block(surface: Surface, beside: Path) -> dict[str, Any]:
    """Return a surface as plain data; beside: the file it is for."""
    keys, unit = [KEY_OF_TERM[term] for term in surface.terms], surface.board.unit
    return {
        "board": boards.block(surface.board),
        "tiers": list(surface.tiers) or None,
        "classes": {
            KEY_OF_CLASS[name]: {"scale": float(scale), "std": float(std)}
            for name, (scale, std) in surface.classes.items()
        }
        or None,
        "coefficients": dict(zip(keys, surface.coefficients.tolist(), strict=True)),
        "uncertainty": covariance.block(keys, surface.covariance, beside),
        f"deflection_{unit}": float(surface.deflection),
        f"deflection_std_{unit}": float(surface.deflection_std),
        "offsets": None if surface.offsets is None else surface.offsets.tolist(),
    }
