"""The covariance of a rectified pair: that of a calibration, carried to the parameters of the rectified cameras.

The images are drawn with the lenses and the transform as they were estimated. If these are off, the rectified images
are those of slightly other cameras: to first order, of the nearest ones with other fx fy cx cy, and another transform.
"""

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.cameras.model import Camera
from camcal.stereo.rectify.record import Rectification

_COLUMNS, _ROWS = 16, 12  # places over the image that the nearest camera is fitted at


def rectified_covariance(
    rectification: Rectification, left: Camera, right: Camera, covariance: Array
) -> FloatArray | None:
    """Return the covariance (14, 14) of fx fy cx cy of the rectified left and right camera and of their right_T_left.

    left, right: the cameras that were rectified. covariance: (N, N) of the parameters of their lenses and of the step
    of right_T_left (order tx ty tz rx ry rz, m and rad; see Pose.retract). None where no lens is known over its image.
    """
    found = rectification
    first, second = len(left.parameters), len(right.parameters)
    jacobian = np.zeros((14, first + second + 6))
    lenses = (
        (left, found.left_camera, found.rect_R_left, slice(0, 4), slice(0, first)),
        (right, found.right_camera, found.rect_R_right, slice(4, 8), slice(first, first + second)),
    )
    for source, view, turn, rows, columns in lenses:
        by_lens = _view_by_lens(source, view, turn)
        if by_lens is None:
            return None
        jacobian[rows, columns] = by_lens
    # with A and B the rotations to rectified axes: A Exp(r) R Bᵀ = Exp(A r) A R Bᵀ, and A (t + s) = A t + A s
    jacobian[8:11, -6:-3] = jacobian[11:, -3:] = found.rect_R_right
    return np.asarray(jacobian @ covariance @ jacobian.T)


def _view_by_lens(source: Camera, view: Camera, view_R_source: Array) -> Array | None:
    """Return the derivatives (4, K) of the parameters of a view by those of the lens it is drawn with."""
    width, height = view.image_size
    grid = np.meshgrid(np.linspace(0, width - 1, _COLUMNS), np.linspace(0, height - 1, _ROWS))
    rays = view.unproject(np.column_stack([axis.ravel() for axis in grid])).directions
    taken = source.model.project_with_jacobians(source.parameters, rays @ view_R_source)
    last = np.array(source.image_size) - 1
    with np.errstate(invalid="ignore"):
        seen = taken.valid & np.all((taken.pixels >= 0) & (taken.pixels <= last), axis=1)
    if seen.sum() < 4:
        return None
    by_lens = taken.by_parameters(len(source.parameters))
    # the ray of a fixed pixel of the source, and where it stands in the view
    ray_by_lens = -np.linalg.pinv(taken.d_point[seen]) @ by_lens[seen]
    drawn = view.model.project_with_jacobians(view.parameters, rays[seen])
    moved = drawn.d_point @ view_R_source @ ray_by_lens
    by_view = drawn.d_parameters.reshape(-1, 4)
    return np.asarray(-np.linalg.lstsq(by_view, moved.reshape(len(by_view), -1), rcond=None)[0])
