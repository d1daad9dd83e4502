"""A camera for images that were resized as a whole."""

import numpy as np

from camcal.cameras.model import Camera
from camcal.errors import InvalidInput


def resized(camera: Camera, image_size: tuple[int, int]) -> Camera:
    """Return the camera of the same images resized to (width, height), its covariance carried along.

    Raises InvalidInput if the sizes differ in shape by more than rounding: such images were cropped.
    """
    if image_size == camera.image_size:
        return camera
    (width, height), (usual_width, usual_height) = image_size, camera.image_size
    if abs(width * usual_height - height * usual_width) > max(*image_size, *camera.image_size):
        raise InvalidInput(
            f"images of {width} x {height} pixels are no resized images of {usual_width} x {usual_height}: "
            "they need a camera of their own"
        )
    scale = width / usual_width, height / usual_height
    parameters = camera.model.rescale(camera.parameters, scale, (0.0, 0.0))
    if camera.covariance is None:
        return Camera(camera.model, image_size, parameters, fixed=camera.fixed)
    # resizing is affine in the parameters: a step of 1 gives the exact derivative
    moved = [camera.model.rescale(camera.parameters + step, scale, (0.0, 0.0)) for step in np.eye(len(parameters))]
    jacobian = np.column_stack(moved) - parameters[:, None]
    return Camera(camera.model, image_size, parameters, jacobian @ camera.covariance @ jacobian.T, camera.fixed)
