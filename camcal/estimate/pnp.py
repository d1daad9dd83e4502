"""The pose of an object from its points and their pixels, with covariance and alternative poses.

Many views are worked on at once. What cannot have a pose is distinguished; every start of the rest is refined to its
minimum of the reprojection error through the package's solver, the lowest one wins, and all are judged with a common
noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from camcal.arrays import FloatArray
from camcal.cameras.model import Camera, Rig
from camcal.errors import CamcalError, InsufficientData, InvalidInput
from camcal.estimate.poses.fits import PoseFit, criterion_of, fits_of, points_needed, pooled
from camcal.estimate.poses.packed_correspondences import Group, alike
from camcal.estimate.poses.pose_quality import SINGULAR, PoseQuality, scaled_eigenvalues
from camcal.estimate.poses.problem import lowest
from camcal.estimate.poses.records import (
    CAMERA_T_OBJECT,
    RIG_T_OBJECT,
    Correspondences,
    PoseEstimate,
    PoseOptions,
)
from camcal.geometry.pose import Pose
from camcal.progress import Outcome

DEFAULTS = PoseOptions()
_OWN_FRAME = Pose.identity()
Item = TypeVar("Item")
Found = dict[int, PoseEstimate | InsufficientData]


def estimate_poses(
    camera: Camera, views: Sequence[Correspondences], options: PoseOptions = DEFAULTS
) -> list[Outcome[Correspondences, PoseEstimate]]:
    """Return camera_T_object of every view, or the InsufficientData that kept it from one, in the views' order.

    The noise of the pixels is that of all views together, unless the options give it.
    """
    seen = [_weighted(view, options) for view in views]
    groups = [
        Group.of([camera], [_OWN_FRAME], [[seen[item]] for item in items], items)
        for items in alike(np.array([len(view.points) for view in views]))
    ]
    found = estimates(groups, options, CAMERA_T_OBJECT)
    return [_outcome(view, found[item]) for item, view in enumerate(views)]


def estimate_pose(
    camera: Camera, points: ArrayLike, pixels: ArrayLike, options: PoseOptions = DEFAULTS
) -> PoseEstimate:
    """Return camera_T_object from points (N, 3) of an object, metres, and the pixels (N, 2) that show them.

    Raises InsufficientData if they have no pose, see `estimate_poses`.
    """
    view = Correspondences("image", np.asarray(points, np.float64), np.asarray(pixels, np.float64))
    outcome = estimate_poses(camera, [view], options)[0]
    if outcome.value is None:
        raise outcome.error or InsufficientData("no pose")
    return outcome.value


def estimate_rig_poses(
    rig: Rig, views: Sequence[Sequence[Correspondences]], options: PoseOptions = DEFAULTS
) -> list[Outcome[Sequence[Correspondences], PoseEstimate]]:
    """Return rig_T_object of every instant from what the rig's cameras saw at it; each view names its camera.

    residuals and inliers of an estimate are those of the instant's views one after another, in the order given.
    Raises InvalidInput for a camera that the rig does not have or that occurs twice in an instant.
    """
    names = list(rig.cameras)
    placed = [_by_camera(names, [_weighted(view, options) for view in instant]) for instant in views]
    cameras = [rig.cameras[name] for name in names]
    frames = [rig.rig_T_camera[name].inverse() for name in names]
    counts = [sum(len(view.points) for view in instant) for instant in views]
    groups = [Group.of(cameras, frames, [placed[item] for item in items], items) for items in alike(np.array(counts))]
    found = estimates(groups, options, RIG_T_OBJECT, rig.covariance)
    return [_outcome(instant, _in_order(found[item], names, instant)) for item, instant in enumerate(views)]


def _weighted(view: Correspondences, options: PoseOptions) -> Correspondences:
    return view if options.noise_px is None else view.alike()


def _outcome(item: Item, found: PoseEstimate | CamcalError) -> Outcome[Item, PoseEstimate]:
    return Outcome(item, error=found) if isinstance(found, CamcalError) else Outcome(item, found)


def _by_camera(names: Sequence[str], instant: Sequence[Correspondences]) -> list[Correspondences | None]:
    """Return the views of an instant in the order of the cameras, None for a camera without one."""
    placed: dict[str, Correspondences] = {}
    for view in instant:
        if view.camera is None or view.camera not in names:
            raise InvalidInput(f"camera {view.camera!r} is not in the rig of {', '.join(names)}", where=view.image)
        if view.camera in placed:
            raise InvalidInput(f"camera {view.camera!r} occurs twice at one instant", where=view.image)
        placed[view.camera] = view
    return [placed.get(name) for name in names]


def _in_order(
    found: PoseEstimate | CamcalError, names: Sequence[str], instant: Sequence[Correspondences]
) -> PoseEstimate | CamcalError:
    """Return an estimate with its points in the order of the instant's views, from that of the cameras."""
    if isinstance(found, CamcalError):
        return found
    by_camera = sorted(range(len(instant)), key=lambda index: names.index(str(instant[index].camera)))
    ends = np.cumsum([len(instant[index].points) for index in by_camera])
    rows = {index: np.arange(end - len(instant[index].points), end) for index, end in zip(by_camera, ends, strict=True)}
    order = np.concatenate([rows[index] for index in range(len(instant))])
    return replace(found, residuals=found.residuals[order], inliers=found.inliers[order])


def estimates(
    groups: Sequence[Group], options: PoseOptions, frames: str, rig_covariance: FloatArray | None = None
) -> Mapping[int, PoseEstimate | InsufficientData]:
    """Return by item the estimate, or what kept it from one; rig_covariance: as in Rig."""
    found: Found = {}
    sound = [_sound(group, options, found) for group in groups]
    fits, noise = fits_of([group for group in sound if len(group.items)], options)
    fits = [_fixed(fit, options, found) for fit in fits]
    noise = noise or pooled(fits)
    criterion = criterion_of(options, noise.sigma) if options.outliers == "many" else None
    for fit in fits:
        quality = PoseQuality(
            fit.problems,
            fit.minima,
            centres=fit.group.centres,
            noise=noise,
            extents=fit.extents,
            intrinsics=options.intrinsics,
            criterion=criterion,
            rig_covariance=rig_covariance,
        )
        for item, estimate in zip(fit.group.items, quality.estimates(frames, fit.group.counts()), strict=True):
            found[int(item)] = estimate
    return found


def _sound(group: Group, options: PoseOptions, found: Found) -> Group:
    """Return the items whose points can fix a pose; the errors of the others go to `found`."""
    obstacles = group.obstacles(points_needed(options), started=options.prior is not None)
    for index, message in obstacles.items():
        found[int(group.items[index])] = InsufficientData(message, where=group.name(index))
    return group.take(np.setdiff1d(np.arange(len(group.items)), list(obstacles))) if obstacles else group


def _fixed(fit: PoseFit, options: PoseOptions, found: Found) -> PoseFit:
    """Return the fit of the items that have a minimum which is a point; the errors of the others go to `found`."""
    best = lowest(fit.minima)
    least = np.full(len(fit.group.items), np.nan)
    least[fit.minima.which[best]] = scaled_eigenvalues(fit.minima.models.normal[best])[:, 0]
    sound = least > SINGULAR
    for index in np.flatnonzero(~sound).tolist():
        if not np.isnan(least[index]):
            condition = 1 / max(least[index], 1e-16)
            message = (
                f"degenerate points: the pose is not determined (condition {condition:.0e}); add points, spread out"
            )
        elif options.outliers == "none":
            message = "no pose puts all points in front of the lens"
            message += "; check the order of u and v, and the camera"
        else:
            message = f"no pose has {points_needed(options)} or more of {sum(fit.group.counts()[index])} points"
            message += "; check that points and pixels correspond"
        found[int(fit.group.items[index])] = InsufficientData(message, where=fit.group.name(index))
    return fit if sound.all() else fit.take(np.flatnonzero(sound))
