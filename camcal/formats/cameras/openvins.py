"""OpenVINS' kalibr_imucam_chain.yaml: Kalibr's camchain under the header of OpenCV, with T_imu_cam, the inverse.

Source: open_vins' ov_core/src/utils/opencv_yaml_parse.h, config/*/kalibr_imucam_chain.yaml.
"""

from pathlib import Path

import numpy as np

from camcal import files
from camcal.formats import emit
from camcal.formats.camera_file import CameraFile
from camcal.formats.cameras import kalibr
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.cameras.record import CameraFormat
from camcal.geometry.pose import Pose

LENSES = Lenses("""
    pinhole-none pinhole fx fy cx cy
    pinhole-radtan opencv4 fx fy cx cy k1 k2 p1 p2
    pinhole-equidistant kannala_brandt4 fx fy cx cy k1 k2 k3 k4
""")


def write(path: Path, file: CameraFile) -> None:
    """Write the cameras as `kalibr.write` does, with the place of each in the IMU; raises as that does."""
    chain = kalibr.chain_of(path, file)
    for block in chain.values():
        if "T_cam_imu" in block:
            pose = Pose.from_matrix(np.array(block.pop("T_cam_imu")))
            block["T_imu_cam"] = pose.inverse().matrix().tolist()
    text = emit.document(chain, FORMAT.note, number=emit.exact_text)
    files.write_text(path, text.replace(emit.HEADER, "%YAML:1.0\n---\n", 1))


FORMAT = CameraFormat(
    name="openvins",
    title="OpenVINS camchain",
    suffixes=(".yaml", ".yml"),
    models=LENSES.models,
    read=kalibr.read,
    write=write,
    lenses=LENSES,
    frames=frozenset({kalibr.IMU}),
    poses="T_imu_cam: imu_T_camera",
    note="name this file under relative_config_imucam; OpenVINS has no lens but pinhole-radtan and pinhole-equidistant",
)
