"""Who looks: one camera, or several that are fixed to each other; and the poses that follow from what they saw."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from camcal.cameras.model import Camera
from camcal.cameras.rig import Rig
from camcal.errors import CamcalError
from camcal.estimate.pnp import Correspondences, PoseEstimate, PoseOptions, estimate_poses, estimate_rig_poses
from camcal.formats.camera_file import Noise
from camcal.formats.poses.record import Sight
from camcal.geometry.pose import Pose
from camcal.report.overlays import Posed
from camcal.tasks.poses.pnp_views import Observation

CAMERA = "camera"


def _known(noise: Mapping[Any, Noise | None]) -> dict[str | None, float]:
    """Return the model errors by camera, of the cameras that have one."""
    return {name: each.model_error_px for name, each in noise.items() if each and each.model_error_px}


@dataclass(frozen=True, eq=False)
class Observer:
    """The cameras by the names that views have (None where there is one only), and the rig they make, if any.

    frame: its name in transforms. noise_px: that of the camera's calibration, None if it is not known.
    model_errors_px: what board and lens model left of it by the names of cameras, as far as it is known.
    """

    frame: str
    cameras: Mapping[str | None, Camera]
    rig: Rig | None = None
    noise_px: float | None = None
    model_errors_px: Mapping[str | None, float] = field(default_factory=dict)

    @classmethod
    def of_camera(cls, camera: Camera, noise: Noise | None = None) -> "Observer":
        """Return an observer that is one camera; noise: of its calibration."""
        errors = _known({None: noise})
        return cls(CAMERA, {None: camera}, noise_px=noise.sigma_px if noise else None, model_errors_px=errors)

    @classmethod
    def of_rig(cls, rig: Rig, frame: str, noise: Mapping[str, Noise | None]) -> "Observer":
        """Return an observer that is a rig; noise: of the calibrations of its cameras."""
        return cls(frame, dict(rig.cameras.items()), rig, model_errors_px=_known(noise))

    def resized(self, cameras: Mapping[str | None, Camera], rig: Rig | None) -> "Observer":
        """Return the same with cameras as they are for images of another size."""
        scales = {name: cameras[name].image_size[0] / camera.image_size[0] for name, camera in self.cameras.items()}
        errors = {name: scales[name] * error for name, error in self.model_errors_px.items()}
        return replace(self, cameras=cameras, rig=rig, model_errors_px=errors)

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

    def with_model_errors(self, observations: Sequence[Observation]) -> tuple[Observation, ...]:
        """Return observations whose pixels' covariances have the cameras' model errors added."""
        return tuple(replace(each, views=tuple(map(self._with_model_error, each.views))) for each in observations)

    def _with_model_error(self, view: Correspondences) -> Correspondences:
        if view.covariance is None or view.camera not in self.model_errors_px:
            return view
        return replace(view, covariance=view.covariance + self.model_errors_px[view.camera] ** 2 * np.eye(2))

    def _pose_in(self, camera: str | None, frame_T_object: Pose) -> Pose:
        """Return camera_T_object of one of the cameras."""
        if self.rig is None or camera is None:
            return frame_T_object
        return self.rig.rig_T_camera[camera].inverse() @ frame_T_object
