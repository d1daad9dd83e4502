"""Messages about the quality of a result: warnings (usable, but weak) and failures (why a gate or verdict failed).

Both have the same record. `CODES` lists all codes except those of the calibration verdict, which are in
`quality/criteria.py` with their limits; docs/messages.md is generated from both.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from camcal.dataclass import dataclass, field, replace
from camcal.parsing import in_one_line
from camcal.records import Brief

Value = float | int | str | tuple[str, ...]


def counted(count: int, noun: str) -> str:
    """Return a count in words: '1 corner', '2 corners'."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


@dataclass(frozen=True)
class Message(Brief):
    """A warning or a failure.

    code: from `CODES`, stable. text: what, how much and what to do, in one line. values: the numbers of the text; their
    names include the unit. where: file, key path, image or object; None if the message is about the whole result.
    """

    code: str
    text: str
    values: Mapping[str, Value] = field(default_factory=dict, hash=False)
    where: str | None = None

    def __str__(self) -> str:
        return f"{in_one_line(self.where)}: {self.text}" if self.where else self.text

    def at(self, where: object) -> "Message":
        """Return the message with a place, unless it has one."""
        return self if self.where else replace(self, where=str(where))


def as_data(messages: Iterable[Message]) -> list[dict[str, Any]]:
    """Return messages as plain data for --json."""
    return [
        {"code": each.code, "text": each.text, "values": dict(each.values), "where": each.where} for each in messages
    ]


CODES: Mapping[str, Mapping[str, str]] = {
    "Detection": {
        "board_size_differs": "the detected ChArUco board has another number of squares than --board",
        "unknown_board_size": "the board has no metric size; lengths are in squares or spacings",
        "symmetric_board": "the board is symmetric, so that the numbering of its corners is ambiguous",
        "orientation_ignored": "EXIF orientation is not applied",
        "mixed_image_sizes": "images of different sizes",
        "demosaiced_colours": "lateral chromatic aberration from demosaiced images",
        "repeated_tag_id": "a tag id was detected more than once in an image",
        "tag_not_refined": "subpixel refinement of a tag failed",
    },
    "Rig calibration": {
        "shifted_captures": "images of two cameras are put together with those of the captures before or after",
        "exchanged_images": "images of one camera are exchanged between two captures",
        "swapped_views": "images of two cameras are swapped in a capture",
        "mirrored_images": "images are mirrored",
        "boards_of_two_sizes": "the boards that two cameras saw are of different sizes",
        "inconsistent_captures": "captures do not agree with the relative pose of the cameras",
        "rig_changed": "the relative pose of two cameras changed between captures",
        "same_images": "two cameras have the same images",
        "left_right_swapped": "the camera called left is the right one",
        "unlinked_camera": "no capture links a camera to the others, or it could not be calibrated",
        "no_common_motion": "two cameras see no motion of the board in common",
        "several_time_offsets": "the motion of the board repeats itself: several time offsets fit",
        "undetermined_time_offset": "the motion of the board does not determine a time offset",
        "unlinked_boards": "no capture and no motion links boards that are joined",
        "undetermined_motion": "the motion that links cameras or boards leaves open how they stand to each other",
        "boards_not_joined": "boards that count as joined move against each other",
        "relation_contradicted": "a given relation of boards contradicts the captures",
        "distance_contradicted": "a measured distance contradicts the captures and the other distances",
        "exposure_motion": "the board moved between the exposures of a capture",
    },
    "Calibration": {
        "too_few_timed_views": "too few images of a moving board tell the times of a camera",
        "undetermined_readout_time": "the motion of the board does not determine a readout time",
        "motion_too_fast": "the board moves too fast for the frame rate, or the time stamps are wrong",
        "views_of_two_cameras": "the views are of two cameras",
        "inconsistent_views": "some views do not match the others",
        "wrong_corners": "too many wrong corners",
        "lens_model_does_not_fit": "residuals vary smoothly over the board",
        "blurred_images": "residuals are random and large",
        "lens_model_or_blur": "residuals are large, of unclear kind",
        "board_does_not_fit": "corner ids do not match the board",
        "board_not_flat": "--flat-board with a bent board",
        "too_few_views": "fewer than three different views with the board",
        "no_tilted_views": "the board was not tilted",
        "screenshots": "the images are screenshots or drawings of the board, not photographs",
        "undetermined_focal_length": "the standard deviation of the focal length is too large",
        "lens_model_failed": "calibration with the best predicting lens model failed",
        "refinement_failed": "calibration with corners refined by the calibrated lens failed",
        "projection_uncertainty": "the projection uncertainty exceeds --max-uncertainty",
        "rerun_differs": "a calibration from a report differs from the one in it",
    },
    "Rigs": {
        "camera_without_board": "no image of a camera of a rig shows the board",
        "unmatched_images": "images without a partner of another camera",
    },
    "Camera files": {
        "untrustworthy": "the calibration in the file is marked as not trustworthy",
        "distortion_not_invertible": "distortion is not invertible in a part of the image",
        "incomplete_uncertainty": "the uncertainty block lacks parameters and is not used",
        "unlikely_principal_point": "the principal point is far from the image centre",
        "unlikely_aspect": "fx and fy differ strongly",
        "unlikely_field_of_view": "the field of view is very small or very large",
        "unlikely_baseline": "the distance between two cameras is very large",
        "large_rms": "the reprojection RMS of the calibration is large",
        "few_images": "the calibration is from few images",
        "rounded_rotation": "a rotation matrix was rounded",
        "assumed_distortion_model": "the file names no distortion model",
        "assumed_no_distortion": "the file has no distortion coefficients",
        "swapped_cameras": "left and right camera files may be swapped",
        "inconsistent_projections": "the projection matrices of a pair do not match",
        "doubtful_distortion_model": "a lens that is said to be plumb_bob has the numbers of a fisheye",
        "unplaced_camera": "a camera without transform to the others",
        "initial_calibration": "a camera of another program has its initial values, which are not adjusted yet",
        "stretched_images": "the lens of a file is that of stretched images",
        "inconsistent_chain": "transforms of a file contradict each other",
        "outside_region": "a view or points lie in parts of the image in which the camera is not known well enough",
        "reduced_scale": "an undistorted image is much smaller at its centre than the source",
        "not_stated": "a camera file does not state what a gate asks for",
        "small_region": "the verdict on a camera holds in a smaller part of the image than --min-coverage",
        "camera_difference": "the projections of two cameras differ by more than --max",
        "camera_difference_sigmas": "the difference of two cameras is more standard deviations than --max-sigma",
        "unknown_difference_std": "the standard deviation of the difference of two cameras is not known",
        "drifted": "new images show that a camera is no longer as calibrated, or stands otherwise",
        "not_shown": "new images would not have shown a drift above the limit",
        "check_image": "the images of a check are noisy, moved, of other sizes, or of a board that has changed",
        "repeated_robot_pose": "poses of a robot are repeated: they show nothing new",
        "doubtful_robot_pose": "poses of a robot fit no other: they hardly count",
        "large_robot_noise": "the noise of a robot is larger than any robot has",
        "robot_delay": "poses of a robot are of other times than the images, which is taken out",
        "robot_scale": "lengths of a robot do not fit those of the board",
        "systematic_robot": "position errors of a robot are linear in position, not noise",
        "images_used_again": "images that a camera was calibrated from are used again: its lens is estimated from them",
        "replaced_view": "the camera file of an undistorted view was replaced by that of another one",
    },
    "Poses": {
        "pose_rms": "a pose exceeds --max-rms",
        "pose_ambiguity": "a pose exceeds --max-ambiguity",
        "pose_inliers": "a pose has fewer inliers than --min-inliers",
        "unlikely_distance": "the object is very near or very far: probably not in metres",
        "mixed_units": "points or views are probably in different units",
        "few_degrees_of_freedom": "noise was estimated from few residuals",
        "residuals_exceed_noise": "residuals are larger than the given noise",
        "other_camera": "residuals are larger than detection and calibration expect: the camera may be another one",
        "few_inliers": "fewer than half of the points are inliers",
        "camera_without_inliers": "a camera of a rig has no inliers",
        "already_undistorted": "the pixels are probably of undistorted images",
        "other_board_shape": "the board shape of the camera file is of another board",
        "no_common_instants": "no object was seen by two cameras of a rig at one instant",
    },
    "Tracks and smoothing": {
        "variable_frame_rate": "--fps replaces the time stamps of a video with variable frame rate",
        "missing_frame_numbers": "--fps is used though frame numbers are missing",
        "repeated_stamps": "poses with repeated time stamps were skipped",
        "successive_rejections": "several successive detections were rejected",
        "overconfident": "innovations are larger than their covariances",
        "underconfident": "innovations are smaller than their covariances",
        "smoothed_already": "poses that `camcal smooth` reads have been smoothed before",
        "filter_gain_too_high": "innovations alternate in sign",
        "correlated_innovations": "innovations are correlated in time",
        "heavy_tails": "too many large innovations",
        "consistency_unknown": "no innovations to judge the covariances by",
        "ambiguous_poses": "many poses may be another solution",
    },
    "Stereo": {
        "swapped_images": "left and right are swapped, or the cameras are toed in",
        "exchanged_cameras": "the cameras were given in the other order",
        "field_not_kept": "rectified images hold less than 85 % of the common field of view",
        "rotated_images": "rectified images are rotated by more than 50° relative to the camera's",
        "converging_cameras": "optical axes meet at less than 0.75 baselines from the cameras",
        "identical_images": "both images are of one view",
        "periodic_texture": "disparities are ambiguous by a period of the texture",
        "row_differences": "row differences exceed --max-rms",
        "rows_not_aligned": "row differences are too large to be corrected",
        "rows_not_checked": "too little of a pair could be matched to measure its row differences",
        "few_matches": "too few pixels were matched",
        "unknown_range": "the disparity range could not be measured",
        "range_too_narrow": "many matches at the end of the disparity range",
        "omitted_disparities": "disparities that the file type cannot store",
        "reduced_disparity_scale": "a PNG with fewer counts per pixel than 256",
        "missing_companion": "a file named beside a disparity map was not found",
        "empty_cloud": "a cloud without points",
        "coarse_coordinates": "coordinates far from the origin lose resolution",
        "likely_scale": "the disparities of map and truth are in different units",
        "unknown_figures": "figures that one of several maps does not have",
        "eval_gate": "a figure exceeds its --gate",
    },
    "Raw frames and sensors": {
        "low_peak": "the largest count is far below the white level",
        "scaled_counts": "counts were scaled to 16 bits",
        "unstable_illumination": "frames of one level differ in brightness",
        "saturation_not_reached": "no flat frame reaches saturation",
        "dark_clipped": "dark counts are clipped at 0",
        "quantisation_limited": "the read noise is below the quantisation noise",
        "gains_differ": "the gains of the colours differ",
    },
    "Lenses": {
        "nominal_sensor_format": "the size of a named sensor format is nominal",
        "sensor_size_differs": "--sensor differs from pixels times pitch",
        "focal_length_differs": "--focal differs from fx times pitch",
        "no_field_of_view": "the lens model is not invertible at the edge of the image",
        "image_circle_too_small": "the image circle does not cover the sensor",
        "diffraction_limited": "the Airy disc is larger than the pixels resolve",
        "motion_blur_expected": "motion blur of more than a pixel",
        "out_of_focus": "a distance outside the depth of field",
        "no_usable_distance": "the board fits the image at no distance where it is sharp and resolved",
        "board_exceeds_image": "the board is larger than the image",
        "board_too_small": "squares or tags are too small",
        "weak_rotation": "the rotation of the board will be uncertain",
        "ambiguous_forecast": "a wrong pose may fit as well",
        "no_forecast": "no calibration can be forecast",
    },
    "Transforms and fits": {
        "assumed_exact": "transforms without covariance beside others with one",
        "equal_weights": "estimates without covariance in a weighted mean",
        "mean_not_unique": "rotations too far apart for a unique mean",
        "inconsistent_estimates": "estimates differ more than their covariances",
        "pixel_origin_differs": "another convention of the pixel origin",
        "velocities_not_written": "velocities are not written",
        "covariance_not_written": "covariances are not written",
        "quaternion_norm": "a quaternion is not normalised",
        "not_a_rotation": "a matrix is not a rotation",
        "last_row": "the last row of a matrix is not 0 0 0 1",
        "strong_correlation": "two parameters are strongly correlated",
    },
    "Batches": {
        "outputs_left": "files that a step of a pipeline wrote before and does not write now are still there",
        "stopped_at_failure": "items that were not begun after another one failed (--fail-fast)",
        "no_workers": "a Dask scheduler has no workers; the items wait for them",
    },
    "Installation": {
        "unusable_package": "a required package is missing or of another version",
        "not_installed": "camcal is not installed as a package",
        "opencv_conflict": "several OpenCV packages are installed",
    },
}
