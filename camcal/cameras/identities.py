"""The same lens in another model, where that is exact: a sphere is a plane's pinhole, one of two, or an ellipsoid.

With f the pixels per radian on the axis: ucm is eucm with β = 1, double_sphere with ξ = 0, and mei with
ξ = α / (1 - α) without distortion, f (1 + ξ); double_sphere with α = 0 is that as well. Any of them is a pinhole where
nothing makes it another lens.
Source: Geyer & Daniilidis, ECCV 2000; Usenko, Demmel & Cremers, 3DV 2018, section 2.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera

_FOUR = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
Values = Mapping[str, float]
Steps = dict[str, tuple[tuple[str, bool, Values], ...]]


def same_lens(camera: Camera) -> tuple[Camera, ...]:
    """Return a camera, first as it is, and in every other lens model that is exactly the same, without covariances."""
    found = {camera.model.name: camera}
    waiting = [camera]
    while waiting:
        own = waiting.pop(0)
        values = dict(zip(own.model.parameter_names, own.parameters.tolist(), strict=True))
        for name, other in _steps(own, values):
            if name not in found:
                model = MODELS[name]
                parameters = [other.get(each, 0.0) for each in model.parameter_names]
                found[name] = Camera(model, own.image_size, np.array(parameters))
                waiting.append(found[name])
    return tuple(found.values())


def _steps(camera: Camera, values: Values) -> Iterator[tuple[str, Values]]:
    """Yield the models that a camera, with these parameters by name, is one exact step from, and their parameters."""
    core = {name: values[name] for name in ("fx", "fy", "cx", "cy")}
    alpha, xi = values.get("alpha", 0.0), values.get("xi", 0.0)
    bare = not any(values.get(name) for name in ("k1", "k2", "p1", "p2"))
    ratio = alpha / (1.0 - alpha) if alpha < 1 else np.inf
    steps: Steps = {
        "pinhole": (("ucm", True, core), ("mei", True, core), ("division", True, core)),
        "ucm": (
            ("eucm", True, {**values, "beta": 1.0}),
            ("double_sphere", True, values),
            ("mei", alpha < 1, {**_stretched(core, 1.0 + ratio), "xi": ratio}),
        ),
        "eucm": (("ucm", values.get("beta") == 1, values),),
        "double_sphere": (("ucm", xi == 0, values), ("mei", alpha == 0 and xi > 0, values)),
        "mei": (
            ("opencv4", xi == 0, values),
            ("ucm", bare, {**_stretched(core, 1.0 / (1.0 + xi)), "alpha": xi / (1.0 + xi)}),
            ("double_sphere", bare and xi <= 1, values),
        ),
    }
    steps |= _fisheye_steps(values)
    if camera.model.is_pinhole(camera.parameters):
        yield "pinhole", core
    yield from ((other, found) for other, holds, found in steps.get(camera.model.name, ()) if holds)


def _fisheye_steps(values: Values) -> Steps:
    """Return the steps between fisheyes with a polynomial, whose coefficients have other names in fisheye624."""
    four, p1, p2 = {name: values.get(name, 0.0) for name in _FOUR}, values.get("p1", 0.0), values.get("p2", 0.0)
    zero = {name for name, value in values.items() if value == 0}
    further = values.keys() - zero - four.keys()
    aria = {f"k{index}": values.get(f"k{index + 1}", 0.0) for index in range(5)}
    back = {f"k{index + 1}": values.get(f"k{index}", 0.0) for index in range(5)}
    return {
        "kannala_brandt4": (
            ("fisheye62", True, four),
            ("thin_prism_fisheye", True, four),
            ("kannala_brandt5t", True, four),
        ),
        "kannala_brandt5t": (
            ("kannala_brandt4", not further, four),
            ("fisheye624", True, {**four, **aria, "p0": p2, "p1": p1}),
            ("fisheye62", not further - {"k5"}, values),
        ),
        "fisheye62": (("kannala_brandt5t", not further - {"k5"}, values), ("opensfm_fisheye624", True, values)),
        "opensfm_fisheye624": (("fisheye62", not further - {"k5", "k6", "p1", "p2"}, values),),
        "thin_prism_fisheye": (("kannala_brandt4", not further, four),),
        "fisheye624": (
            (
                "kannala_brandt5t",
                not further - {"k0", "p0", "p1"} and not values.get("k5"),
                {**four, **back, "p1": p1, "p2": values.get("p0", 0.0)},
            ),
        ),
    }


def _stretched(core: Values, scale: float) -> Values:
    return {**core, "fx": core["fx"] * scale, "fy": core["fy"] * scale}
