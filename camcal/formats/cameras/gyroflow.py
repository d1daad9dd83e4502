"""Gyroflow lens profiles: one camera a JSON file, for frames of calib_dimension.

A profile without distortion_model is of the fisheye model. frame_readout_time is in ms. What has no place in
a lens (the stretch of anamorphic frames) is kept (x_gyroflow) and written again; an anamorphic lens is that of the
widened frames.
Source: gyroflow's src/core/lens_profile.rs and distortion_models.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.record import CAMERA, CameraFormat, Given, Source
from camcal.formats.cameras.syntax import json_text, json_values
from camcal.formats.cameras.values import Lenses, Values

VENDOR_KEY = "x_gyroflow"
LENSES = Lenses("""
    opencv_fisheye kannala_brandt4 fx fy cx cy k1 k2 k3 k4
    opencv_standard opencv12 fx fy cx cy k1 k2 p1 p2 k3? k4? k5? k6? s1? s2? s3? s4?
    poly3 opencv4 fx fy cx cy k1 =0? =0? =0?
    poly5 opencv4 fx fy cx cy k1 k2 =0? =0?
    ptlens ptlens fx fy cx cy a=a4 b=a3 c=a2
    generic_polynomial its_polynomial fx fy cx cy k0 k1 k2 k3 k4 k5
    insta360 mei fx fy cx cy k1 k2 k3=0 p1 p2 xi
    sony sony fx fy cx cy k0 k1 k2 k3 k4 k5
""")  # fmt: skip

_READOUT, _MS = "frame_readout_time", 1e-3
_KEPT = ("fps", "input_horizontal_stretch", "input_vertical_stretch", "camera_brand",
         "camera_model", "lens_model", "camera_setting")  # fmt: skip


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera of a profile; raises InvalidInput for a lens that camcal does not have, FileError."""
    values = json_values(sources[0])
    lens = values.below("fisheye_params")
    if values.text("digital_lens"):
        what = f"{values.text('digital_lens')!r} bends the frames once more: calibrate frames without it"
        raise values.wrong("digital_lens", what)
    word = values.text("distortion_model")
    standard = values.data.get("use_opencv_standard") is True
    word = word or ("opencv_standard" if standard else "opencv_fisheye")
    rows = LENSES.of(values, "distortion_model", word)
    core = lens.camera_matrix("camera_matrix")
    coefficients = lens.numbers("distortion_coeffs") if "distortion_coeffs" in lens else np.zeros(0)
    if not coefficients.any() and len(coefficients) < rows[0].counts[0] - 4:
        coefficients = np.zeros(rows[0].counts[0] - 4)
    key = next((key for key in ("calib_dimension", "orig_dimension") if key in values), None)
    size = None if key is None else (values.below(key).side("w"), values.below(key).side("h"))
    size = given.size(size, values.document.where)
    camera = LENSES.listed(lens, "distortion_coeffs", rows, size, np.concatenate([core, coefficients]))
    kept = {name: values.data[name] for name in _KEPT if isinstance(values.data.get(name), (str, int, float))}
    _warn_of_stretch(values)
    quality = {"rms_px": lens.number("RMS_error")} if lens.data.get("RMS_error") else {}
    timing = {"readout_s": _MS * values.number(_READOUT)} if values.data.get(_READOUT) is not None else {}
    entry = CameraEntry(camera, quality=quality, timing=timing, extra={VENDOR_KEY: kept} if kept else {})
    return CameraFile({CAMERA: entry}, warnings=(*values.warnings, *lens.warnings))


def _warn_of_stretch(values: Values) -> None:
    for name in ("input_horizontal_stretch", "input_vertical_stretch"):
        stretch = values.number(name) if name in values else 1.0
        if stretch not in (0.0, 1.0):
            values.warn(
                "stretched_images", name, f"the lens is that of frames stretched by {stretch:g}: stretch them so"
            )


def write(path: Path, file: CameraFile) -> None:
    """Write a camera as a profile; raises FileError."""
    ((name, entry),) = file.cameras.items()
    lens, numbers = LENSES.written(entry.camera)
    width, height = entry.camera.image_size
    own = entry.extra.get(VENDOR_KEY)
    kept: dict[str, Any] = own if isinstance(own, dict) else {}
    size, readout = {"w": width, "h": height}, entry.timing.get("readout_s")
    data = {
        "name": str(kept.get("camera_model") or name),
        "note": GYROFLOW.note,
        "calibrated_by": "camcal",
        **dict.fromkeys(("camera_brand", "camera_model", "lens_model", "camera_setting"), ""),
        "calib_dimension": size,
        "orig_dimension": size,
        "output_dimension": size,
        "fps": 0.0,
        _READOUT: None if readout is None else readout / _MS,
        "input_horizontal_stretch": 1.0,
        "input_vertical_stretch": 1.0,
        **kept,
        "num_images": int(entry.quality.get("images_used", 0)),
        "calibrator_version": "",
        "distortion_model": lens.word,
        "fisheye_params": {
            "RMS_error": float(entry.quality.get("rms_px", 0.0)),
            "camera_matrix": entry.camera.K.tolist(),
            "distortion_coeffs": list(numbers.values())[4:],
            "radial_distortion_limit": None,
        },
    }
    files.write_text(path, json_text(data))


GYROFLOW = CameraFormat(
    name="gyroflow",
    title="Gyroflow lens profile",
    suffixes=(".json",),
    models=LENSES.models,
    read=read,
    write=write,
    lenses=LENSES,
    most_cameras=1,
    keeps=frozenset({"rms"}),
    note="put it into Gyroflow's folder of camera presets; frame_readout_time is in ms",
)
