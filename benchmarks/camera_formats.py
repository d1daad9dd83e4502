"""Round trips of camera files: what camcal, OpenCV and PyYAML read of what camcal has written.

Cameras have random parameters of 17 digits. Shown is the largest relative difference of any parameter; of pairs and
chains the largest difference of any element of their transforms, metres.
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import yaml

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.formats import cameras
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.formats.cameras import FORMATS
from camcal.geometry.pose import Pose

FILES = (("opencv", ".yml"), ("opencv", ".xml"), ("opencv", ".json"), ("ros", ".yaml"), ("kalibr", ".yaml"))


def random_camera(model: str, rng: np.random.Generator) -> Camera:
    """Return a camera whose coefficients have all magnitudes from 1e-9 to 0.1."""
    count = len(MODELS[model].parameter_names) - 4
    core = np.array(
        [rng.uniform(1500, 5000), rng.uniform(1500, 5000), rng.uniform(1800, 2200), rng.uniform(1350, 1650)]
    )
    coefficients = rng.choice([-1, 1], count) * 10 ** rng.uniform(-9, -1, count)
    return Camera(MODELS[model], (4000, 3000), np.concatenate([core, coefficients]))


def by_camcal(path: Path) -> np.ndarray:
    return cameras.read_camera(path).parameters


def by_opencv(path: Path) -> np.ndarray:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    matrix = storage.getNode("camera_matrix").mat()
    return np.concatenate(
        [matrix[[0, 1, 0, 1], [0, 1, 2, 2]], storage.getNode("distortion_coefficients").mat().ravel()]
    )


def by_pyyaml(path: Path) -> np.ndarray:
    block = yaml.safe_load(path.read_text())
    if "cam0" in block:
        return np.array(block["cam0"]["intrinsics"] + block["cam0"]["distortion_coeffs"])
    matrix = np.array(block["camera_matrix"]["data"])
    return np.concatenate([matrix[[0, 4, 2, 5]], block["distortion_coefficients"]["data"]])


READERS = {"opencv": (by_camcal, by_opencv), "ros": (by_camcal, by_opencv, by_pyyaml), "kalibr": (by_camcal, by_pyyaml)}


def lens_rows(folder: Path, count: int, rng: np.random.Generator) -> Iterator[tuple[str, ...]]:
    for name, suffix in FILES:
        form, path = FORMATS[name], folder / f"camera{suffix}"
        worst = dict.fromkeys((by_camcal, by_opencv, by_pyyaml))
        for model in form.models:
            for _ in range(count):
                camera = random_camera(model, rng)
                cameras.write(path, CameraFile({"camera": CameraEntry(camera)}), form)
                for reader in READERS[name]:
                    apart = float(np.abs(reader(path) / camera.parameters - 1).max())
                    worst[reader] = max(worst[reader] or 0.0, apart)
        figures = ("" if each is None else f"{each:.1g}" for each in worst.values())
        yield (f"{form.title} {suffix}", str(len(form.models)), *figures)


def pair_rows(folder: Path, count: int, rng: np.random.Generator) -> Iterator[tuple[str, str]]:
    for name, suffix in FILES:
        worst = 0.0
        for _ in range(count):
            pose = Pose.from_vector(rng.normal(0, 0.1, 3), np.array([-1.0, 0.0, 0.0]) * rng.uniform(0.02, 2))
            pose = Pose(pose.rotation, pose.translation + rng.normal(0, 0.01, 3))
            lens = "kannala_brandt4" if name == "kalibr" else "opencv5"
            pair = {side: CameraEntry(random_camera(lens, rng)) for side in ("cam0", "cam1")}
            path = folder / ("pair" if name == "ros" else f"pair{suffix}")
            cameras.write(path, CameraFile(pair, {"cam1_T_cam0": Transform(pose)}), FORMATS[name])
            files = (path / "cam0.yaml", path / "cam1.yaml") if name == "ros" else (path, None)
            (back,) = cameras.read(files[0], second=files[1]).transforms.values()
            worst = max(worst, float(np.abs(back.pose.matrix() - pose.matrix()).max()))
        yield f"{FORMATS[name].title} {suffix}", f"{worst:.1g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cameras", type=int, default=100, help="of every lens model")
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    print(f"OpenCV {cv2.__version__}, PyYAML {yaml.__version__}, {arguments.cameras} cameras of every lens model\n")
    with tempfile.TemporaryDirectory() as name:
        print("| format | lens models | camcal | OpenCV | PyYAML |\n|---|---|---|---|---|")
        for row in lens_rows(Path(name), arguments.cameras, rng):
            print(f"| {' | '.join(row)} |")
        print("\n| format | transform of a pair |\n|---|---|")
        for row in pair_rows(Path(name), arguments.cameras, rng):
            print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
