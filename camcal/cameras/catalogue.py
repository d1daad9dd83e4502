"""The lens models by name. A new model adds a file, whose MODELS it is among, and its name to the line of that file."""

from collections.abc import Iterator, Mapping
from importlib import import_module

from camcal.cameras.lens import CameraModel
from camcal.cameras.plane_model import TILTED, PlaneModel
from camcal.errors import InvalidInput
from camcal.parsing import nearest

_FILES = {
    "brown": "pinhole opencv4 opencv5 opencv8 opencv12 opencv14",
    "kannala_brandt": "kannala_brandt4 kannala_brandt5t kannala_brandt4_tilted fisheye62 opensfm_fisheye624 "
    "thin_prism_fisheye fisheye624",
    "sphere_models": "ucm eucm double_sphere mei",
    "short_models": "fov division orthographic equisolid",
    "angle_models": "ftheta ftheta_inverse ptlens ptlens_equisolid ptlens_stereographic ocam",
    "telecentric": "telecentric",
    "panoramic": "cylinder equirectangular stereographic cylinder_x latlon_x",
    "spline": "splined_stereographic",
}


class _Models(Mapping[str, CameraModel]):
    """The lens models by name; a file is imported when one of its models is asked for, as a camera needs one alone.

    A name with TILTED behind it is that lens on a tilted sensor: there, though not among the names.
    """

    def __init__(self) -> None:
        self.files = {name: file for file, names in _FILES.items() for name in names.split()}

    def __getitem__(self, name: str) -> CameraModel:
        if name not in self.files and name.endswith(TILTED):
            lens = self[name.removesuffix(TILTED)]
            if isinstance(lens, PlaneModel) and lens.tilted is not None:
                return lens.tilted
        models: tuple[CameraModel, ...] = import_module(f"camcal.cameras.{self.files[name]}").MODELS
        return next(model for model in models if model.name == name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.files)

    def __len__(self) -> int:
        return len(self.files)


MODELS = _Models()

DEFAULT_MODEL = "opencv5"  # of a lens of which nothing is known
WIDE_MODEL = "kannala_brandt4"  # holds narrow and wide lenses alike
SPLINE_MODEL = "splined_stereographic"  # holds what no parametric one does


def model_named(name: str) -> CameraModel:
    """Return the lens model called `name`, or with that alias; raises InvalidInput with the nearest name there is."""
    if name in MODELS:
        return MODELS[name]
    aliases = {alias: model for model in MODELS.values() for alias in model.aliases}
    base = name.removesuffix(TILTED)
    if base in aliases and (known := aliases[base].name + name[len(base) :]) in MODELS:
        return MODELS[known]
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
    names = [f"{model.name} ({', '.join(model.aliases)})" if model.aliases else model.name for model in lenses]
    return f"{', '.join(names)}; add {TILTED} for a tilted sensor"
