"""Who looks: one camera, or several that are fixed to each other; and the poses that follow from what they saw."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from camcal.cameras.model import Camera
from camcal.cameras.rig import Rig
from camcal.errors import CamcalError
from camcal.estimate.pnp import PoseEstimate, PoseOptions, estimate_poses, estimate_rig_poses
from camcal.formats.poses.record import Sight
from camcal.geometry.pose import Pose
from camcal.report.overlays import Posed
from camcal.tasks.poses.pnp_views import Observation

CAMERA = "camera"


@dataclass(frozen=True, eq=False)
class Observer:
    """The cameras by the names that views have (None where there is one only), and the rig they make, if any.

    frame: its name in transforms. noise_px: that of the camera's calibration, None if it is not known.
    """

    frame: str
    cameras: Mapping[str | None, Camera]
    rig: Rig | None = None
    noise_px: float | None = None

    @classmethod
    def of_camera(cls, camera: Camera, noise_px: float | None = None) -> "Observer":
        """Return an observer that is one camera."""
        return cls(CAMERA, {None: camera}, noise_px=noise_px)

    @classmethod
    def of_rig(cls, rig: Rig, frame: str) -> "Observer":
        """Return an observer that is a rig."""
        return cls(frame, dict(rig.cameras.items()), rig)

    def estimates(
        self, observations: Sequence[Observation], settings: PoseOptions
    ) -> tuple[dict[Sight, PoseEstimate], dict[Sight, CamcalError]]:
        """Return frame_T_object of every sight, and what kept others from a pose."""
        results: list[tuple[PoseEstimate | None, CamcalError | None]]
        if self.rig is None:
            single = estimate_poses(self.cameras[None], [each.views[0] for each in observations], settings)
            results = [(outcome.value, outcome.error) for outcome in single]
        else:
            joint = estimate_rig_poses(self.rig, [each.views for each in observations], settings)
            results = [(outcome.value, outcome.error) for outcome in joint]
        sights = [each.sight for each in observations]
        found = {sight: value for sight, (value, _) in zip(sights, results, strict=True) if value is not None}
        return found, {sight: error for sight, (_, error) in zip(sights, results, strict=True) if error is not None}

    def posed(
        self, observation: Observation, estimate: PoseEstimate, words: str
    ) -> dict[tuple[str, str | None], Posed]:
        """Return an object as each of the cameras saw it, by image and camera; words: what a picture says of it."""
        ends = np.cumsum([len(view.points) for view in observation.views])[:-1]
        masks = np.split(estimate.inliers, ends)
        return {
            (view.image, view.camera): Posed(
                self.cameras[view.camera],
                self._pose_in(view.camera, estimate.transform),
                view.points,
                view.pixels,
                mask,
                words,
                observation.sight.object,
            )
            for view, mask in zip(observation.views, masks, strict=True)
        }

    def _pose_in(self, camera: str | None, frame_T_object: Pose) -> Pose:
        """Return camera_T_object of one of the cameras."""
        if self.rig is None or camera is None:
            return frame_T_object
        return self.rig.rig_T_camera[camera].inverse() @ frame_T_object
