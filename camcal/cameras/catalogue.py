"""The lens models by name. A new model adds a file, whose MODELS it lists, and the line with the name of that file."""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType

from camcal.cameras.lens import CameraModel
from camcal.errors import InvalidInput
from camcal.parsing import nearest

_FILES = (
    "brown",
    "kannala_brandt",
    "sphere_models",
    "short_models",
    "angle_models",
    "panoramic",
    "rectified_views",
    "spline",
)
_REGISTERED: dict[str, CameraModel] = {
    model.name: model for file in _FILES for model in import_module(f"camcal.cameras.{file}").MODELS
}
MODELS: Mapping[str, CameraModel] = MappingProxyType(_REGISTERED)

DEFAULT_MODEL = "opencv5"  # of a lens of which nothing is known
WIDE_MODEL = "kannala_brandt4"  # holds narrow and wide lenses alike


def model_named(name: str) -> CameraModel:
    """Return the lens model called `name`, or with that alias; raises InvalidInput with the nearest name there is."""
    if name in MODELS:
        return MODELS[name]
    aliases = {alias: model for model in MODELS.values() for alias in model.aliases}
    if name in aliases:
        return aliases[name]
    near = nearest(name, [*MODELS, *aliases])
    hint = f"did you mean {near!r}?" if near else f"use one of {', '.join(MODELS)}"
    raise InvalidInput(f"lens model {name!r} is unknown; {hint}")


def model_of(name: str, configuration: object = None) -> CameraModel:
    """Return the lens model of the catalogue with this name, configured; raises InvalidInput for what is wrong."""
    if not isinstance(configuration, Mapping | None):
        raise InvalidInput(f"{configuration!r}: write a mapping")
    return MODELS[name].configured(configuration or {})


def help_line() -> str:
    """Return the lens models that cameras are calibrated with, as the help of a command names them."""
    lenses = [model for model in MODELS.values() if not model.is_view]
    return ", ".join(f"{model.name} ({', '.join(model.aliases)})" if model.aliases else model.name for model in lenses)
