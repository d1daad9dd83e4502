"""The lens models by name: the one line that a new model adds."""

from collections.abc import Mapping
from difflib import get_close_matches
from types import MappingProxyType

from camcal.cameras import brown, kannala_brandt, panoramic
from camcal.cameras.model import CameraModel
from camcal.errors import InvalidInput

MODELS: Mapping[str, CameraModel] = MappingProxyType(
    {model.name: model for model in (*brown.MODELS, *kannala_brandt.MODELS, *panoramic.MODELS)}
)


def model_named(name: str) -> CameraModel:
    """Return the lens model called `name`; raises InvalidInput with the nearest name there is."""
    if name in MODELS:
        return MODELS[name]
    near = get_close_matches(name, MODELS, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"use one of {', '.join(MODELS)}"
    raise InvalidInput(f"lens model {name!r} is unknown; {hint}")
