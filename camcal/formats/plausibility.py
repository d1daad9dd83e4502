"""What breaks no rule in a camera file and yet looks wrong: numbers of another resolution, folds, millimetres."""

import math
from collections.abc import Iterator

import numpy as np

from camcal.cameras.model import Camera
from camcal.cameras.validity import field_of_view, folds_inside
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.documents import Fault, child

OFF_CENTRE = 0.25  # of the image's side: more than any lens is decentred, less than a wrong resolution
ASPECT = (0.9, 1.1)
FIELD_DEG = (3.0, 200.0)
LARGE_RMS = 1.0
FEW_IMAGES = 10
FAR = 20.0  # metres between two cameras; 20 and more are probably millimetres


def implausible(file: CameraFile) -> Iterator[Fault]:
    """Yield what a reader should know before trusting a camera file, with the key in camcal's own format."""
    for name, entry in file.cameras.items():
        path = child("cameras", name)
        yield from _principal_point(entry.camera, child(path, "intrinsics"))
        yield from _aspect(entry.camera, child(path, "intrinsics"))
        if not entry.camera.model.is_view:  # a view, not a lens: it may show all around
            yield from _opening(entry, child(path, "intrinsics"))
            yield from _folding(entry, child(path, "distortion"))
        yield from _quality(entry, child(path, "quality"))
        yield from _verdict(entry, child(path, "verdict"))
    for name, transform in file.transforms.items():
        distance = float(np.linalg.norm(transform.pose.translation))
        if distance > FAR:
            yield Fault(child(child("transforms", name), "t"), f"{distance:g} m: are these millimetres?")


def _principal_point(camera: Camera, path: str) -> Iterator[Fault]:
    for name, side, what in zip(("cx", "cy"), camera.image_size, ("width", "height"), strict=True):
        value = camera.value(name)
        if abs(value - (side - 1) / 2) > OFF_CENTRE * side:
            yield Fault(child(path, name), f"{name}={value:g} for {what} {side}: are these of another resolution?")


def _aspect(camera: Camera, path: str) -> Iterator[Fault]:
    ratio = camera.value("fx") / camera.value("fy")
    if not ASPECT[0] <= ratio <= ASPECT[1]:
        yield Fault(path, f"fx/fy = {ratio:.3g}: anamorphic or stretched video? check the display aspect ratio")


def _opening(entry: CameraEntry, path: str) -> Iterator[Fault]:
    horizontal = math.degrees(field_of_view(entry.camera, entry.image_circle)[0])
    if horizontal < FIELD_DEG[0] or horizontal > FIELD_DEG[1]:
        text = f"horizontal field of view {horizontal:.3g}°: are the focal length and image_size of one resolution?"
        yield Fault(child(path, "fx"), text)


def _folding(entry: CameraEntry, path: str) -> Iterator[Fault]:
    fold = folds_inside(entry.camera, entry.image_circle)
    if fold.folds:
        limit = f"distortion is not invertible beyond {fold.radius_px:.0f} px from the centre"
        end = "image corner is at" if entry.image_circle is None else "image circle reaches to"
        yield Fault(path, f"{limit}; the {end} {fold.corner_px:.0f} px")


def _quality(entry: CameraEntry, path: str) -> Iterator[Fault]:
    rms, images = entry.quality.get("rms_px", 0.0), entry.quality.get("images_used", FEW_IMAGES)
    if rms > LARGE_RMS:
        yield Fault(child(path, "rms_px"), f"{rms:g} px is a poor fit; a good calibration is below {LARGE_RMS:g}")
    if images < FEW_IMAGES:
        yield Fault(child(path, "images_used"), f"{images} images; take {FEW_IMAGES} or more")


def _verdict(entry: CameraEntry, path: str) -> Iterator[Fault]:
    if entry.verdict is not None and not entry.verdict.trustworthy:
        reasons = " ".join("; ".join(entry.verdict.reasons).split())  # a warning is one line
        yield Fault(path, f"do not trust this calibration: {reasons or 'no reason is given'}")
