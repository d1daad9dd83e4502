"""Warnings about implausible numbers in camera files: another resolution, folds, millimetres."""

import math
from collections.abc import Iterator

import numpy as np

from camcal.cameras.model import Camera
from camcal.cameras.validity import field_of_view, folds_inside
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.documents import child
from camcal.messages import Message

OFF_CENTRE = 0.25  # of the image's side: more than any lens is decentred, less than a wrong resolution
ASPECT = (0.9, 1.1)
FIELD_DEG = (3.0, 200.0)
LARGE_RMS = 1.0
FEW_IMAGES = 10
FAR = 20.0  # metres between two cameras; 20 and more are probably millimetres


def implausible(file: CameraFile) -> Iterator[Message]:
    """Yield warnings about a camera file, each with its key path in camcal's own format."""
    for name, entry in file.cameras.items():
        path = child("cameras", name)
        yield from _principal_point(entry.camera, child(path, "intrinsics"))
        yield from _aspect(entry.camera, child(path, "intrinsics"))
        if not entry.camera.model.is_view:  # a view, not a lens: it may show all around
            yield from _opening(entry, child(path, "intrinsics"))
            yield from _folding(entry, child(path, "distortion"))
        yield from _quality(entry, child(path, "quality"))
        yield from untrustworthy(entry, child(path, "verdict"))
    for name, transform in file.transforms.items():
        distance = float(np.linalg.norm(transform.pose.translation))
        if distance > FAR:
            place = child(child("transforms", name), "t")
            yield Message("unlikely_baseline", f"{distance:g} m: check the unit", {"distance_m": distance}, place)


def _principal_point(camera: Camera, path: str) -> Iterator[Message]:
    for name, side, what in zip(("cx", "cy"), camera.image_size, ("width", "height"), strict=True):
        value = camera.value(name)
        if abs(value - (side - 1) / 2) > OFF_CENTRE * side:
            text = f"{name} = {value:g} for image {what} {side}: check that both are of one resolution"
            yield Message("unlikely_principal_point", text, {name: value, what: side}, child(path, name))


def _aspect(camera: Camera, path: str) -> Iterator[Message]:
    ratio = camera.value("fx") / camera.value("fy")
    if not ASPECT[0] <= ratio <= ASPECT[1]:
        text = f"fx/fy = {ratio:.3g}: check the pixel aspect ratio (anamorphic or stretched video)"
        yield Message("unlikely_aspect", text, {"fx_over_fy": ratio}, path)


def _opening(entry: CameraEntry, path: str) -> Iterator[Message]:
    horizontal = math.degrees(field_of_view(entry.camera, entry.image_circle)[0])
    if horizontal < FIELD_DEG[0] or horizontal > FIELD_DEG[1]:
        text = f"horizontal field of view {horizontal:.3g}°: check that fx and image_size are of one resolution"
        yield Message("unlikely_field_of_view", text, {"horizontal_deg": horizontal}, child(path, "fx"))


def _folding(entry: CameraEntry, path: str) -> Iterator[Message]:
    fold = folds_inside(entry.camera, entry.image_circle)
    if fold.folds:
        limit = f"distortion is not invertible beyond {fold.radius_px:.0f} px from the centre"
        end = "image corner is at" if entry.image_circle is None else "image circle reaches to"
        values = {"radius_px": fold.radius_px, "corner_px": fold.corner_px}
        yield Message("distortion_not_invertible", f"{limit}; the {end} {fold.corner_px:.0f} px", values, path)


def _quality(entry: CameraEntry, path: str) -> Iterator[Message]:
    rms, images = entry.quality.get("rms_px", 0.0), entry.quality.get("images_used", FEW_IMAGES)
    if rms > LARGE_RMS:
        text = f"reprojection RMS {rms:g} px (limit {LARGE_RMS:g} px): calibrate again"
        yield Message("large_rms", text, {"rms_px": rms, "limit_px": LARGE_RMS}, child(path, "rms_px"))
    if images < FEW_IMAGES:
        text = f"{images} images: use {FEW_IMAGES} or more"
        yield Message("few_images", text, {"images": images, "limit": FEW_IMAGES}, child(path, "images_used"))


def untrustworthy(entry: CameraEntry, path: str) -> Iterator[Message]:
    """Yield a warning at a path if the file says that the calibration of a camera must not be trusted."""
    if entry.verdict is not None and not entry.verdict.trustworthy:
        reasons = " ".join("; ".join(entry.verdict.reasons).split())  # a warning is one line
        yield Message("untrustworthy", f"untrustworthy calibration: {reasons or 'no reason given'}", where=path)
