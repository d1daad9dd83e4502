"""From views to estimates: what cannot have a pose is told apart, the rest fitted, and judged with a common noise."""

from collections.abc import Mapping, Sequence

import numpy as np

from camcal.errors import InsufficientData
from camcal.estimate.poses.fits import Fit, agreement_of, fits_of, points_needed, pooled
from camcal.estimate.poses.groups import Group
from camcal.estimate.poses.judgement import Judgement
from camcal.estimate.poses.minima import lowest
from camcal.estimate.poses.moments import SINGULAR, scaled_eigenvalues
from camcal.estimate.poses.records import PoseEstimate, PoseOptions

Found = dict[int, PoseEstimate | InsufficientData]


def estimates(
    groups: Sequence[Group], options: PoseOptions, frames: str
) -> Mapping[int, PoseEstimate | InsufficientData]:
    """Return by item the estimate, or what kept it from one."""
    found: Found = {}
    sound = [_sound(group, options, found) for group in groups]
    fits, noise = fits_of([group for group in sound if len(group.items)], options)
    fits = [_fixed(fit, options, found) for fit in fits]
    noise = noise or pooled(fits)
    agreement = agreement_of(options, noise.sigma) if options.outliers == "many" else None
    for fit in fits:
        judgement = Judgement(
            fit.problems, fit.minima, fit.group.centres, noise, fit.extents, options.intrinsics, agreement
        )
        for item, estimate in zip(fit.group.items, judgement.estimates(frames, fit.group.counts()), strict=True):
            found[int(item)] = estimate
    return found


def _sound(group: Group, options: PoseOptions, found: Found) -> Group:
    """Return the items whose points can fix a pose; the errors of the others go to `found`."""
    obstacles = group.obstacles(points_needed(options), started=options.prior is not None)
    for index, message in obstacles.items():
        found[int(group.items[index])] = InsufficientData(message, where=group.name(index))
    return group.take(np.setdiff1d(np.arange(len(group.items)), list(obstacles))) if obstacles else group


def _fixed(fit: Fit, options: PoseOptions, found: Found) -> Fit:
    """Return the fit of the items that have a minimum which is a point; the errors of the others go to `found`."""
    best = lowest(fit.minima)
    least = np.full(len(fit.group.items), np.nan)
    least[fit.minima.which[best]] = scaled_eigenvalues(fit.minima.models.normal[best])[:, 0]
    sound = least > SINGULAR
    for index in np.flatnonzero(~sound).tolist():
        if not np.isnan(least[index]):
            condition = 1 / max(least[index], 1e-16)
            message = f"the points do not fix the pose (condition {condition:.0e}); add points, spread out"
        elif options.outliers == "none":
            message = "no pose puts all points in front of the lens"
            message += "; are u and v exchanged, or is it another camera's image?"
        else:
            message = f"no pose agrees with {points_needed(options)} or more of {sum(fit.group.counts()[index])} points"
            message += "; do points and pixels belong together?"
        found[int(fit.group.items[index])] = InsufficientData(message, where=fit.group.name(index))
    return fit if sound.all() else fit.take(np.flatnonzero(sound))
