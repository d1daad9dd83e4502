"""Point clouds by other ways: NumPy as textbooks write it, OpenCV, Open3D; and how seconds and memory are measured.

    INTERPRETER cloud_peers.py NAME FOLDER REPEATS   measures one work and prints a JSON object

FOLDER holds disparity.npy (H, W), image.npy (H, W, 3) blue, green, red, points.npy (N, 3), colours.npy (N, 3) and
scene.json: fx, cx, cy, baseline, voxel, radius. Clouds are written into it as NAME.ply.
The interpreter is one of an environment with `pip install open3d opencv-python-headless`.
"""

import ctypes
import json
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


def main() -> None:
    name, folder, repeats = sys.argv[1:]
    if name == "versions":
        print(json.dumps(versions()))
        return
    scene = Scene(Path(folder))
    print(json.dumps(measured(WORKS[name](scene, scene.folder / f"{name}.ply"), int(repeats))))


def measured(work: Callable[[], int], repeats: int) -> dict[str, Any]:
    """Return the seconds of every run by the clock and of all processors, the points of `work`, and its memory.

    The memory is the highest the process had during a first run, less what it had before, in MB (Linux).
    """
    extra = peak_of(work)
    clock, processor = [], []
    for _ in range(repeats):
        start = time.perf_counter(), time.process_time()
        points = work()
        clock.append(time.perf_counter() - start[0])
        processor.append(time.process_time() - start[1])
    return {"seconds": clock, "processor": processor, "extra_mb": extra, "points": int(points)}


def peak_of(work: Callable[[], int]) -> float | None:
    status, forget = Path("/proc/self/status"), Path("/proc/self/clear_refs")
    if not forget.exists():
        work()
        return None
    ctypes.CDLL(None).malloc_trim(0)  # what earlier works have left to be used again would not be counted
    forget.write_text("5")
    before = memory(status, "VmRSS")
    work()
    return (memory(status, "VmHWM") - before) / 1e3


def memory(status: Path, name: str) -> int:
    return int(re.search(rf"{name}:\s+(\d+)", status.read_text())[1])


def versions() -> dict[str, str]:
    import cv2
    import open3d

    return {"Open3D": open3d.__version__, "OpenCV": cv2.__version__, "numpy": np.__version__}


class Scene:
    """What is measured on; arrays are read when they are first asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.numbers = json.loads((folder / "scene.json").read_text())

    def __getattr__(self, name: str) -> Any:
        if name in self.numbers:
            return self.numbers[name]
        array = np.load(self.folder / f"{name}.npy")
        setattr(self, name, array)
        return array

    def cloud(self) -> Any:
        """Return an Open3D cloud of the points."""
        import open3d as o3d

        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(self.points.astype(float)))
        cloud.colors = o3d.utility.Vector3dVector(self.colours / 255.0)
        return cloud

    def depth(self) -> Any:
        depth = np.float32(self.fx * self.baseline) / self.disparity
        return np.nan_to_num(depth, copy=False)


def textbook(scene: Scene, path: Path) -> Callable[[], int]:
    disparity, image = scene.disparity, scene.image

    def work() -> int:
        v, u = np.mgrid[: disparity.shape[0], : disparity.shape[1]].astype(float)
        z = scene.fx * scene.baseline / disparity
        points = np.stack([(u - scene.cx) * z / scene.fx, (v - scene.cy) * z / scene.fx, z], axis=-1)
        known = disparity > 0
        return written(path, points[known], image[known])

    return work


def opencv(scene: Scene, path: Path) -> Callable[[], int]:
    import cv2

    disparity, image = scene.disparity, scene.image
    q = np.array([[1, 0, 0, -scene.cx], [0, 1, 0, -scene.cy], [0, 0, 0, scene.fx], [0, 0, 1 / scene.baseline, 0]])

    def work() -> int:
        points, known = cv2.reprojectImageTo3D(disparity, q), disparity > 0
        return written(path, points[known], image[known])

    return work


def written(path: Path, points: np.ndarray, colours: np.ndarray) -> int:
    record = np.empty(len(points), [(name, "<f4") for name in "xyz"] + [(name, "u1") for name in "rgb"])
    for i, (position, colour) in enumerate(zip("xyz", "bgr", strict=True)):
        record[position], record[colour] = points[:, i], colours[:, i]
    properties = [f"property float {name}" for name in "xyz"]
    properties += [f"property uchar {name}" for name in ("red", "green", "blue")]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *properties, "end_header", ""]
    with path.open("wb") as file:
        file.write("\n".join(lines).encode())
        record.tofile(file)
    return len(points)


def open3d_tensor(scene: Scene, path: Path) -> Callable[[], int]:
    import open3d as o3d

    image = np.ascontiguousarray(scene.image[..., ::-1])
    camera = o3d.core.Tensor([[scene.fx, 0, scene.cx], [0, scene.fx, scene.cy], [0, 0, 1]])
    scene.disparity  # noqa: B018 - it is read now

    def work() -> int:
        rgbd = o3d.t.geometry.RGBDImage(o3d.t.geometry.Image(image), o3d.t.geometry.Image(scene.depth()))
        cloud = o3d.t.geometry.PointCloud.create_from_rgbd_image(rgbd, camera, depth_scale=1.0, depth_max=1e6)
        o3d.t.io.write_point_cloud(str(path), cloud)
        return len(cloud.point.positions)

    return work


def open3d_legacy(scene: Scene, path: Path) -> Callable[[], int]:
    import open3d as o3d

    image = np.ascontiguousarray(scene.image[..., ::-1])
    height, width = scene.disparity.shape
    camera = o3d.camera.PinholeCameraIntrinsic(width, height, scene.fx, scene.fx, scene.cx, scene.cy)

    def work() -> int:
        rgbd = o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(image), o3d.geometry.Image(scene.depth()), 1.0, 1e6, convert_rgb_to_intensity=False
        )
        cloud = o3d.geometry.PointCloud.create_from_rgbd_image(rgbd, camera)
        o3d.io.write_point_cloud(str(path), cloud)
        return len(cloud.points)

    return work


def statistical_outliers(scene: Scene, _: Path) -> Callable[[], int]:
    cloud = scene.cloud()
    return lambda: len(cloud.remove_statistical_outlier(20, 2.0)[1])


def radius_outliers(scene: Scene, _: Path) -> Callable[[], int]:
    cloud = scene.cloud()
    return lambda: len(cloud.remove_radius_outlier(6, scene.radius)[1])


def normals(scene: Scene, _: Path) -> Callable[[], int]:
    import open3d as o3d

    cloud = scene.cloud()

    def work() -> int:
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(30))
        return len(cloud.normals)

    return work


def voxels(scene: Scene, _: Path) -> Callable[[], int]:
    cloud = scene.cloud()
    return lambda: len(cloud.voxel_down_sample(scene.voxel).points)


WORKS = {
    "NumPy as in textbooks": textbook,
    "OpenCV reprojectImageTo3D": opencv,
    "Open3D tensor": open3d_tensor,
    "Open3D legacy": open3d_legacy,
    "Open3D statistical, 20 neighbours": statistical_outliers,
    "Open3D radius, 6 neighbours": radius_outliers,
    "Open3D, 30 neighbours": normals,
    "Open3D": voxels,
}

if __name__ == "__main__":
    main()
