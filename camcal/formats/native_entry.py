"""One camera of a camera file: its lens and everything else that is known of it."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from camcal.cameras.catalogue import MODELS
from camcal.cameras.validity import ImageCircle
from camcal.formats import native_lens
from camcal.formats.camera_file import CameraEntry, Noise, ProjectionStd, ValidRegion, Verdict
from camcal.formats.schema import VENDOR, flag, integer, items, mapping, number, one_of, plain, text
from camcal.formats.strict_yaml import Check, Fault, child

FIGURES = ("rms_px", "mean_px", "median_px", "p95_px", "max_px", "chi2_per_degree")
COUNTS = ("images_used", "images_total", "points_used", "points_total", "points_rejected")
VALID: Mapping[str, Check] = {
    "max_theta_deg": number(0, 180),
    "max_radius_px": number(above=0),
    "polygon": items(items(number(), 2)),
    "image_circle": mapping({"centre_px": items(number(), 2), "radius_px": number(above=0)}),
}
SENSOR: Mapping[str, Check] = {
    "pixel_pitch_um": number(above=0),
    "gain_e_per_dn": number(above=0),
    "read_noise_e": number(0),
    "full_well_e": number(above=0),
    "black_level_dn": number(0),
    "bits": integer(1),
}


def _model(value: Any, path: str) -> Iterator[Fault]:
    yield from one_of(tuple(MODELS), "model")(value, path)


def _unchecked(_value: Any, _path: str) -> tuple[Fault, ...]:
    """Pass anything: native_lens checks it once the model is known."""
    return ()


_LENS = dict.fromkeys(("distortion", "fixed", "uncertainty"), _unchecked)
_ENTRY = mapping(
    {"image_size": items(integer(1), 2), "model": _model, "intrinsics": _unchecked},
    {
        **_LENS,
        "configuration": mapping({}, others=plain),
        "held_by_prior": _unchecked,
        "valid": mapping({}, VALID),
        "quality": mapping({}, {**dict.fromkeys(FIGURES, number(0)), **dict.fromkeys(COUNTS, integer(0))}),
        "noise": mapping({"sigma_px": number(0)}, {"degrees_of_freedom": integer(1), "model_error_px": number(0)}),
        "verdict": mapping({"trustworthy": flag}, {"reasons": items(text)}),
        "sensor": mapping({}, SENSOR),
        "channels": mapping({}, others=mapping({"intrinsics": _unchecked}, _LENS)),
    },
)


def check(data: Any, path: str) -> Iterator[Fault]:
    """Check one camera."""
    yield from _ENTRY(data, path)
    name = data.get("model") if isinstance(data, dict) else None
    if not isinstance(name, str) or name not in MODELS:
        return
    yield from native_lens.check(data, path, MODELS[name])
    yield from native_lens.check_held_by_prior(data, path, MODELS[name])
    if "configuration" in data:
        yield Fault(child(path, "configuration"), f"model {name!r} takes no configuration; leave it out")
    channels = data.get("channels")
    for colour, lens in channels.items() if isinstance(channels, dict) else ():
        if isinstance(lens, dict):
            yield from native_lens.check(lens, child(child(path, "channels"), colour), MODELS[name])


def read(data: Mapping[str, Any], folder: Path) -> tuple[CameraEntry, tuple[str, ...]]:
    """Return the entry of data that has passed `check`, and the parameters that lack an uncertainty others have."""
    model, size = MODELS[data["model"]], (data["image_size"][0], data["image_size"][1])
    camera, unknown = native_lens.read(data, model, size, folder)
    channels = {name: native_lens.read(lens, model, size, folder)[0] for name, lens in data.get("channels", {}).items()}
    return CameraEntry(
        camera,
        valid=_read_valid(data["valid"], size) if "valid" in data else None,
        projection=tuple(map(_read_projection, data.get("uncertainty", {}).get("projection", ()))),
        quality=data.get("quality", {}),
        noise=Noise(**data["noise"]) if "noise" in data else None,
        verdict=_read_verdict(data["verdict"]) if "verdict" in data else None,
        sensor=data.get("sensor", {}),
        channels=channels,
        held_by_prior=tuple(data.get("held_by_prior", ())),
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


def _read_verdict(data: Mapping[str, Any]) -> Verdict:
    return Verdict(data["trustworthy"], tuple(data.get("reasons", ())))


def block(entry: CameraEntry, beside: Path) -> dict[str, Any]:
    """Return the data of one camera; beside: the file it is for."""
    camera = entry.camera
    data: dict[str, Any] = {"image_size": list(camera.image_size), "model": camera.model.name}
    data.update(native_lens.block(camera, beside))
    data["held_by_prior"] = list(entry.held_by_prior) or None
    if entry.projection:
        data.setdefault("uncertainty", {})["projection"] = [
            {"range_m": item.range_m, **item.figures} for item in entry.projection
        ]
    data["valid"] = _valid_block(entry.valid) if entry.valid else None
    data["quality"] = entry.quality or None
    data["noise"] = vars(entry.noise) if entry.noise else None
    data["verdict"] = vars(entry.verdict) if entry.verdict else None
    data["sensor"] = entry.sensor or None
    data["channels"] = {name: native_lens.block(lens, beside) for name, lens in entry.channels.items()} or None
    return {**data, **entry.extra}


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
