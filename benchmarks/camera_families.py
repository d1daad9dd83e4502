"""Camera files of other programs, read by these programs themselves, and how many files a second camcal reads.

--write FOLDER writes a camera of every lens that camcal and a family share, and the pixels of 1000 points. --check
FOLDER reads the files with pycolmap and OpenCV, in an environment that has them and needs no camcal, and shows the
largest difference of any pixel. --speed FOLDER reads all files below a folder, in CPU time, after one of each suffix.
"""

import argparse
import json
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

POINTS = np.column_stack([np.random.default_rng(0).uniform(-0.7, 0.7, (1000, 2)), np.ones(1000)])
SIZE = (752, 480)
OTHERS = ("camcal", "isaac", "urdf", "ros_tf")  # camcal's own, and what it writes and does not read


def write(folder: Path) -> None:
    from camcal.cameras.catalogue import MODELS
    from camcal.cameras.model import Camera
    from camcal.formats import cameras
    from camcal.formats.camera_file import CameraEntry, CameraFile
    from camcal.formats.cameras import FORMATS

    rng = np.random.default_rng(1)
    for form in FORMATS.values():
        rows = (
            [(row.word, row.model, {own.name for own in row.keys}) for row in form.lenses.rows] if form.lenses else []
        )
        rows = rows or [(name, name, set(MODELS[name].parameter_names)) for name in form.models]
        for index, (word, model_name, names) in enumerate(rows if form.suffixes and form.name not in OTHERS else ()):
            model = MODELS.get(model_name)
            if model is None:
                continue
            values = {"fx": 458.654, "fy": 458.654 if "f" in names else 457.296, "cx": 375.5, "cy": 239.5}
            drawn = model.prior_mean + 0.01 * rng.normal(size=len(model.parameter_names))
            values |= {
                name: value
                for name, value in zip(model.parameter_names[4:], drawn[4:].tolist(), strict=True)
                if name in names
            }
            values |= {"cx": 367.215, "cy": 248.375} if "cx" in names else {}
            parameters = np.array([values.get(name, 0.0) for name in model.parameter_names])
            camera = Camera(model, SIZE, parameters)
            for suffix in form.suffixes:
                path = folder / f"{form.name}-{index}-{word}{suffix}"
                cameras.write(path, CameraFile({"camera": CameraEntry(camera)}), form)
                pixels = camera.project(POINTS).pixels.tolist()
                path.with_name(path.name + ".pixels").write_text(json.dumps(pixels))


def by_pycolmap(path: Path) -> np.ndarray:
    import pycolmap

    with tempfile.TemporaryDirectory() as folder:  # a model has images and points, none here
        for name in ("cameras", "images", "points3D"):
            target = Path(folder) / f"{name}{path.suffix}"
            target.write_bytes(path.read_bytes() if name == "cameras" else b"" if path.suffix == ".txt" else bytes(8))
        (camera,) = pycolmap.Reconstruction(folder).cameras.values()
    return np.array([camera.img_from_cam(point) for point in POINTS]) - 0.5


def by_matrices(matrix: np.ndarray, coefficients: np.ndarray, fisheye: bool) -> np.ndarray:
    zero = np.zeros(3)
    if fisheye:
        return cv2.fisheye.projectPoints(POINTS[:, None], zero, zero, matrix, coefficients)[0][:, 0]
    return cv2.projectPoints(POINTS, zero, zero, matrix, coefficients)[0][:, 0]


def by_opencv(path: Path) -> np.ndarray:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    matrix, coefficients = (storage.getNode(key).mat() for key in ("camera_matrix", "distortion_coefficients"))
    if not (xi := storage.getNode("xi")).empty():
        mirror, zero = xi.real() if xi.isReal() else float(xi.mat().ravel()[0]), np.zeros(3)
        return cv2.omnidir.projectPoints(POINTS[:, None], zero, zero, matrix, mirror, coefficients)[0][:, 0]
    return by_matrices(matrix, coefficients, storage.getNode("fisheye_model").real() == 1)


def by_mrcal(path: Path) -> np.ndarray:
    import mrcal

    return mrcal.project(POINTS, *mrcal.cameramodel(str(path)).intrinsics())


def by_orb_slam(path: Path) -> np.ndarray:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    fisheye = storage.getNode("Camera.type").string() == "KannalaBrandt8"
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    fx, fy, cx, cy, *coefficients = (
        storage.getNode(f"Camera1.{key}").real() for key in ("fx", "fy", "cx", "cy", *names)
    )
    return by_matrices(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.array(coefficients), fisheye)


def by_toml(path: Path) -> np.ndarray:
    import tomllib

    data = tomllib.loads(path.read_text())
    table = next(iter(data.get("cameras", data).values()))
    return by_matrices(np.array(table["matrix"]), np.array(table["distortions"]), bool(table.get("fisheye")))


def by_gyroflow(path: Path) -> np.ndarray:
    data = json.loads(path.read_text())
    lens = data["fisheye_params"]
    fisheye = data["distortion_model"] == "opencv_fisheye"
    return by_matrices(np.array(lens["camera_matrix"]), np.array(lens["distortion_coeffs"]), fisheye)


def by_matlab(path: Path) -> np.ndarray:
    from scipy.io import loadmat

    lens = loadmat(str(path), simplify_cells=True)["camera"]
    matrix = lens["K"] - np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
    if "DistortionCoefficients" in lens:
        return by_matrices(matrix, lens["DistortionCoefficients"], True)
    radial = [*lens["RadialDistortion"], 0.0][:3]
    return by_matrices(matrix, np.array([*radial[:2], *lens["TangentialDistortion"], radial[2]]), False)


READERS = {
    "colmap": ("pycolmap", by_pycolmap),
    "opencv": ("cv2.FileStorage", by_opencv),
    "orbslam3": ("cv2.FileStorage", by_orb_slam),
    "anipose": ("tomllib, cv2", by_toml),
    "caliscope": ("tomllib, cv2", by_toml),
    "mrcal": ("mrcal", by_mrcal),
    "gyroflow": ("json, cv2", by_gyroflow),
    "matlab": ("scipy.io, cv2", by_matlab),
}


def check(folder: Path) -> None:
    print("| family | read by | files | largest difference, px |\n|---|---|---|---|")
    for family, (reader, read) in READERS.items():
        paths = [path for path in sorted(folder.glob(f"{family}-*")) if path.suffix not in (".pixels", "")]
        if family == "matlab":
            paths = [path for path in paths if path.suffix == ".mat"]
        if family == "gyroflow":
            paths = [path for path in paths if "opencv" in path.name]
        expected = [np.array(json.loads(path.with_name(path.name + ".pixels").read_text())) for path in paths]
        with suppress(ModuleNotFoundError):  # mrcal is in another environment than the rest
            apart = [np.abs(read(path) - pixels).max() for path, pixels in zip(paths, expected, strict=True)]
            print(f"| {family} | {reader} | {len(paths)} | {max(apart):.1e} |")


def speed(folder: Path) -> None:
    from camcal.errors import CamcalError
    from camcal.formats import cameras

    def outcome(path: Path) -> str:
        try:
            return f"{len(cameras.read(path).cameras)} cameras"
        except CamcalError as error:
            return type(error).__name__

    paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    for path in {path.suffix: path for path in paths}.values():
        outcome(path)
    started = time.process_time()
    outcomes = [outcome(path) for path in paths]
    spent = time.process_time() - started
    refused = sum(not each.endswith("cameras") for each in outcomes)
    print(f"{len(paths)} files, {refused} refused, {len(paths) / spent:.0f} a second of CPU time")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write files and pixels")
    parser.add_argument("--check", type=Path, metavar="FOLDER", help="read them with other programs")
    parser.add_argument("--speed", type=Path, metavar="FOLDER", help="read all files below a folder with camcal")
    arguments = parser.parse_args()
    for name, run in (("write", write), ("check", check), ("speed", speed)):
        folder = getattr(arguments, name)
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            run(folder)


if __name__ == "__main__":
    main()
