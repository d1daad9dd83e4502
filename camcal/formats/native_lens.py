"""The lens of a camera file: a model's parameters by name, which of them were held, how well the others are known.

intrinsics: {fx: 458.654, fy: 457.296, cx: 367.215, cy: 248.375}
distortion: {k1: -0.28340811, k2: 0.07395907, p1: 0.00019359, p2: 1.76187114e-05, k3: 0.0}
fixed: [k3]
uncertainty: {std: {fx: 0.41, ...}, covariance_order: [fx, ...], covariance: [[...], ...]}
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal.cameras.model import Camera, CameraModel
from camcal.formats import covariance
from camcal.formats.schema import did_you_mean, items, mapping, number, one_of
from camcal.formats.strict_yaml import Fault, child, nearest

CORE = ("fx", "fy", "cx", "cy", "skew")  # named under intrinsics; all others are named under distortion

_FOCAL = ("fx", "fy")
_POSITIVE = number(above=0, hint=" (mirrored image? flip the image instead)")
PROJECTION_FIGURES = ("centre_px", "rms_px", "median_px", "p95_px", "max_px", "inside_rms_px", "inside_max_px")
_UNCERTAINTY = mapping(
    {},
    {
        **covariance.KEYS,
        "projection": items(mapping({}, {"range_m": number(above=0), **dict.fromkeys(PROJECTION_FIGURES, number(0))})),
    },
)


def check(block: Mapping[str, Any], path: str, model: CameraModel) -> Iterator[Fault]:
    """Check the keys of a lens of the given model; other keys of the block are not looked at."""
    names = model.parameter_names
    yield from _check_names(block.get("intrinsics", {}), child(path, "intrinsics"), model, _core(names))
    yield from _check_names(block.get("distortion", {}), child(path, "distortion"), model, _distortion(names))
    fixed = block.get("fixed", [])
    yield from items(one_of(names, "parameter"))(fixed, child(path, "fixed"))
    uncertainty, where = block.get("uncertainty", {}), child(path, "uncertainty")
    faults = list(_UNCERTAINTY(uncertainty, where))
    yield from faults or covariance.check(uncertainty, where, names, fixed if isinstance(fixed, list) else ())


def check_held_by_prior(block: Mapping[str, Any], path: str, model: CameraModel) -> Iterator[Fault]:
    """Check the names of coefficients that a prior holds: some of the model's that were not fixed."""
    held, fixed = block.get("held_by_prior", []), block.get("fixed", [])
    where = child(path, "held_by_prior")
    faults = list(items(one_of(_distortion(model.parameter_names), "coefficient"))(held, where))
    yield from faults
    for index, name in enumerate([] if faults else held):
        if name in held[:index]:
            yield Fault(child(where, index), f"{name!r} stands twice")
        elif isinstance(fixed, list) and name in fixed:
            yield Fault(child(where, index), f"{name!r} is fixed and has no prior; leave it out")


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
            yield from (_POSITIVE if name in _FOCAL else number(*model.limits[name]))(value, child(path, name))
        else:
            misspelt.add(nearest(name, missing))
            yield Fault(child(path, name), f"model {model.name!r} has no {name!r} here{did_you_mean(name, missing)}")
    missing = [name for name in missing if name not in misspelt]
    if missing:
        lacks = f"model {model.name!r} needs {','.join(names)}; missing {', '.join(map(repr, missing))}"
        yield Fault(path, lacks if missing[0] in CORE else f"{lacks} (write {missing[0]}: 0.0)")


def read(
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


def block(camera: Camera, beside: Path) -> dict[str, Any]:
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
