"""A camera from what people know of one: lens model, image size, field of view, distortion."""

from collections.abc import Mapping

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera, CameraModel
from camcal.errors import InvalidInput

WIDEST = 100.0  # half an image's width in focal lengths, 178.9° for a pinhole
OFF_CENTRE = (0.006, -0.004)  # of the principal point, as shares of the image's width


def make_camera(
    model: CameraModel, size: tuple[int, int], fov: float, distortion: Mapping[str, float] | None = None
) -> Camera:
    """Return a camera whose images of `size` (width, height) are `fov` (rad) wide.

    distortion: coefficients by name, the others are zero; None for typical ones and a principal point off the centre.
    Raises InvalidInput if the model has no such coefficient or cannot hold the field of view.
    """
    if min(size) < 16 or max(size) > 32000:
        raise InvalidInput(f"images of {size[0]} × {size[1]} are not simulated; use 16 to 32000 a side")
    unit = _distorted(model, model.start((1, 1), 1.0), distortion)
    edge = model.project(unit, np.array([[np.sin(fov / 2), 0.0, np.cos(fov / 2)]]))
    if not 0 < fov < 2 * np.pi or not edge.valid[0] or not 0 < edge.pixels[0, 0] < WIDEST:
        raise InvalidInput(f"{model.name} cannot hold a field of view of {np.degrees(fov):g}° with this distortion")
    parameters = _distorted(model, model.start(size, size[0] / 2 / edge.pixels[0, 0]), distortion)
    if distortion is None:
        parameters[2:4] += np.array(OFF_CENTRE) * size[0]
    return Camera(model, size, parameters)


def _distorted(model: CameraModel, parameters: Array, distortion: Mapping[str, float] | None) -> Array:
    if distortion is None:
        distortion = model.typical
    for name, value in distortion.items():
        if name not in model.parameter_names[4:]:
            known = ", ".join(model.parameter_names[4:]) or "none"
            raise InvalidInput(f"{model.name} has no coefficient {name!r}; it has {known}")
        parameters[model.parameter_names.index(name)] = value
    return parameters
