"""A pose that is known beforehand: from a pose file of `camcal pnp`, or from a file with a pose as text."""

from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.pnp import PosePrior
from camcal.formats import pose_text, poses
from camcal.geometry.pose import Pose, inverse_jacobian
from camcal.tasks.poses.options import PriorOptions


def read_prior(options: PriorOptions, of_object: bool) -> PosePrior | None:
    """Return the prior of the object's pose in the frame of the camera or rig, None without one.

    of_object: whether a pose as text takes points of the object to the camera; a pose file says so itself.
    Raises InvalidInput for a pose file with several poses, and if nothing says how well the pose is known.
    """
    if options.path is None:
        return None
    if options.path.suffix.lower() in poses.SUFFIXES:
        pose, covariance = _from_poses(options.path)
    else:
        pose, covariance = pose_text.read(options.path), None
        if not of_object:
            pose = pose.inverse()
    if options.sigma is not None:
        covariance = _isotropic(pose, options.sigma, of_object)
    if covariance is None:
        raise InvalidInput(
            "a pose as text has no covariance: give --prior-sigma METRES,DEGREES", where=str(options.path)
        )
    return PosePrior(pose, covariance)


def _from_poses(path: Path) -> tuple[Pose, Array]:
    found = poses.read(path)
    if len(found.estimates) != 1:
        raise InvalidInput(f"holds {len(found.estimates)} poses; a prior is one", where=str(path))
    record = next(iter((found if found.of_object else found.inverse()).estimates.values()))
    return record.transform, record.covariance


def _isotropic(pose: Pose, sigma: tuple[float, float], of_object: bool) -> Array:
    """Return the covariance (6, 6) of camera_T_object where its own steps, or those of its inverse, have `sigma`."""
    covariance = np.diag(np.repeat(np.square(sigma), 3))
    if of_object:
        return covariance
    jacobian = inverse_jacobian(pose.inverse())
    return np.asarray(jacobian @ covariance @ jacobian.T)
