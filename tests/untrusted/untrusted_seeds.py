"""Good files of every kind that camcal reads."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from untrusted_readers import CLOUDS, LONG_CLOUDS, MAPS

from camcal.formats import cameras, detections, disparity_sidecar, native, pointclouds
from camcal.formats import disparity as disparity_map
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.disparity_sidecar import Sidecar
from camcal.geometry.pose import Pose
from camcal.images.files import save
from camcal.raw.dng import write_dng
from camcal.raw.mosaic import Mosaic
from camcal.simulate.scene import observe, views
from camcal.stereo.depth import VertexStream, vertex_type
from camcal.stereo.disparity import StereoGeometry
from camcal.targets.board import Board

_SIZE = (96, 72)  # width, height
_SAMPLES = Path(__file__).parents[2] / "sample_configs"
_SAMPLE_FILES = {
    "camera.yaml": "cameras/webcam.yaml",
    "fisheye.yaml": "cameras/fisheye.yaml",
    "rig.yaml": "cameras/stereo_rig.yaml",
    "tags.yaml": "tags/cube.yaml",
    "board.yaml": "boards/chessboard_25mm.yaml",
    "charuco.yaml": "boards/charuco_a4.yaml",
    "circles.yaml": "boards/asymmetric_circles_20mm.yaml",
    "kalibr_target.yaml": "boards/kalibr_aprilgrid.yaml",
    "disparity.yaml": "stereo_disparity.yaml",
    "undistort.yaml": "undistort.yaml",
}

_PAIR = """format: camcal-calibration
version: 1
cameras:
  left: {image_size: [96, 72], model: opencv4, intrinsics: {fx: 100.0, fy: 100.0, cx: 47.0, cy: 35.0},
    distortion: {k1: -0.1, k2: 0.02, p1: 0.0, p2: 0.0}}
  right: {image_size: [96, 72], model: opencv4, intrinsics: {fx: 100.0, fy: 100.0, cx: 47.0, cy: 35.0},
    distortion: {k1: -0.1, k2: 0.02, p1: 0.0, p2: 0.0}}
transforms:
  right_T_left: {R: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], t: [-0.1, 0.0, 0.0]}
"""


def make(folder: Path, run: Callable[[list[str]], None]) -> None:
    """Write every good file into `folder`; run: a function that runs a command line and raises if it fails."""
    rng = np.random.default_rng(3)
    _make_images(folder, rng)
    _make_raw(folder, rng)
    _make_maps_and_clouds(folder, rng)
    make_texts(folder)
    _make_detections(folder, rng)
    _make_with_commands(folder, run)


def _make_images(folder: Path, rng: np.random.Generator) -> None:
    width, height = _SIZE
    y, x = np.mgrid[:height, :width]
    squares = (((x - 4) // 11 + (y - 3) // 11) % 2 * 200 + 20 + rng.integers(0, 8, (height, width))).astype(np.uint8)
    squares[:3], squares[69:], squares[:, :4], squares[:, 92:] = 220, 220, 220, 220
    colour = np.stack([squares, squares // 2, 255 - squares], axis=2)
    for name in ("gray.png", "gray.jpg", "gray.pgm", "gray.npy"):
        save(folder / name, squares)
    for name in ("colour.png", "colour.jpg", "colour.tiff", "colour.bmp", "colour.ppm"):
        save(folder / name, colour)
    save(folder / "right.png", np.roll(squares, -3, axis=1))
    for name in ("deep.png", "deep.tiff"):
        save(folder / name, squares.astype(np.uint16) * 257)
    save(folder / "float.tiff", squares.astype(np.float32))
    cv2.imwrite(str(folder / "colour.webp"), colour)
    cv2.imwrite(str(folder / "gray.jp2"), squares)
    video = cv2.VideoWriter(str(folder / "clip.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, _SIZE)
    for shift in range(3):
        video.write(np.roll(colour, shift, axis=1))
    video.release()
    for number in (1, 2):
        flat = np.clip(rng.poisson(2000, squares.shape), 0, 4095).astype(np.uint16)
        for name in (f"flat_{number}.png", f"flat_{number}.tiff", f"flats/{number}.png"):
            save(folder / name, flat)
        save(folder / f"darks/{number}.png", np.rint(rng.normal(100, 3, squares.shape)).astype(np.uint16))
    save(folder / "visible.png", np.where(squares > 100, 255, 0).astype(np.uint8))


def _make_raw(folder: Path, rng: np.random.Generator) -> None:
    width, height = _SIZE
    counts = rng.integers(100, 4000, (height, width)).astype(np.uint16)
    for suffix in ("png", "tiff", "pgm", "npy"):
        save(folder / f"mosaic.{suffix}", counts)
    write_dng(folder / "negative.dng", Mosaic(counts, "RGGB", np.full((2, 2), 64.0), 4095.0))
    (folder / "dump.raw").write_bytes(rng.bytes(width * height * 3 // 2))
    (folder / "matrix.txt").write_text("1.5 -0.4 -0.1\n-0.2 1.4 -0.2\n0 -0.5 1.5  # to sRGB\n")
    (folder / "bad.txt").write_text("# x y time\n3 4 0\n10 20\n")
    np.save(folder / "bad.npy", np.array([[3, 4], [10, 20]]))


def _make_maps_and_clouds(folder: Path, rng: np.random.Generator) -> None:
    width, height = _SIZE
    map_ = (10 + rng.random((height, width))).astype(np.float32)
    for name in (*MAPS, "bare.pfm"):
        disparity_map.write(folder / name, map_)
    geometry = StereoGeometry(100.0, 100.0, 47.0, 35.0, 0.1)
    disparity_sidecar.write(folder / "map.pfm", Sidecar(1.0, "inf", geometry, searched=(0, 32)))
    vertices = np.zeros(60, vertex_type(colour=True, normals=True))
    for name in vertices.dtype.names or ():
        vertices[name] = rng.random(60) * (200 if vertices.dtype[name].kind == "u" else 1)
    for name in (*CLOUDS, *LONG_CLOUDS):
        stream = VertexStream(len(vertices), vertices.dtype, [vertices])
        pointclouds.write(folder / name, stream, ascii_text=name.startswith("text"))


def make_texts(folder: Path) -> None:
    """Write the good files that nothing has to be computed for."""
    for name, sample in _SAMPLE_FILES.items():
        (folder / name).write_bytes((_SAMPLES / sample).read_bytes())
    texts = {
        "calib.txt": "cam0=[100 0 47; 0 100 35; 0 0 1]\ncam1=[100 0 47; 0 100 35; 0 0 1]\ndoffs=0\nbaseline=100\n"
        "width=96\nheight=72\nndisp=32\n",
        "kitti_calib.txt": "".join(f"P{k}: 100 0 47 {-10 * (k % 2)} 0 100 35 0 0 0 1 0\n" for k in range(4)),
        "points.csv": "x,y,z,sxx,sxy,sxz,syy,syz,szz,name\n" + "".join(f"{k},1,2,1,0,0,1,0,1,p{k}\n" for k in range(9)),
        "path.tum": "# frames: w_T_c\n"
        + "".join(f"{k * 0.1:.1f} {k * 0.01} {k % 3 * 0.01} 1 0 0 0 1\n" for k in range(30)),
        "path.csv": "t,tx,ty,tz,qw,qx,qy,qz\n" + "".join(f"{k * 0.1:.1f},{k * 0.01},0,1,1,0,0,0\n" for k in range(30)),
        "kitti.txt": "".join(f"1 0 0 {k * 0.01} 0 1 0 0 0 0 1 2\n" for k in range(30)),
        "euroc.csv": "#timestamp, x, y, z, qw, qx, qy, qz\n"
        + "".join(f"{k * 100_000_000},{k * 0.01},0,1,1,0,0,0\n" for k in range(30)),
        "series.csv": "t,x,y,sigma\n" + "".join(f"{k * 0.1:.1f},{k % 7},{k},0.5\n" for k in range(30)),
        "pose.txt": "# a_T_b\n1 0 0 0.1\n0 1 0 0.2\n0 0 1 0.3\n0 0 0 1\n",
        "frames.yaml": "transforms:\n"
        "  a_T_b: {R: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], t: [1.0, 0.0, 0.5],"
        " std: [0.1, 0.1, 0.1, 0.01, 0.01, 0.01]}\n  b_T_c: {euler: {axes: ZYX, deg: [90.0, 0.0, -90.0]},"
        " t: [0.0, 0.1, 0.0]}\n",
        "fit.csv": "x,y\n" + "".join(f"{k},{2 * k + k % 3}\n" for k in range(20)),
        "line.txt": "0.1 0.2 0.3 0 0 0 1\n",
        "times.csv": "image,t\n" + "".join(f"view{k:04d}.png,{k * 0.1:.1f}\n" for k in range(8)),
        "pipeline.yaml": "variables: {camera: small.yaml}\nsteps:\n  opencv:\n    command: convert\n"
        "    arguments: [$(camera), out/small.xml]\n  undistort:\n    command: undistort\n"
        "    arguments: [$(camera), gray.png]\n    alpha: 1\n    output: out/straight\n",
        "pair.yaml": _PAIR,
        "calibrate.yaml": "model: opencv5\nfree-corners: false\nflat-board: true\n",
        "settings.yaml": "%YAML 1.1\n---\nrecursive: false\nquiet: true\n",
        "pixels.csv": "u,v,name\n10,20,a\n30.5,40.25,b\n",
        "points.pnp.csv": "image,id,X,Y,Z,u,v,sigma\n" + _correspondences("a.png,{id},{X},{Y},0,{u},{v},0.3\n"),
        "points.yaml": "points:\n" + _correspondences("  - {{id: {id}, X: {X}, Y: {Y}, Z: 0.0, u: {u}, v: {v}}}\n"),
        "points.json": '{"points": ['
        + _correspondences('{{"id": {id}, "X": {X}, "Y": {Y}, "Z": 0.0, "u": {u}, "v": {v}}},').rstrip(",")
        + "]}\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def _correspondences(form: str) -> str:
    places = [(column, row) for row in range(4) for column in range(5)]
    return "".join(
        form.format(id=k, X=0.1 * c, Y=0.1 * r, u=300.0 + 40 * c + r, v=200.0 + 41 * r)
        for k, (c, r) in enumerate(places)
    )


def _make_detections(folder: Path, rng: np.random.Generator) -> None:
    camera = cameras.read_camera(folder / "camera.yaml")
    board = Board("chessboard", 7, 5, 0.025)
    small = replace(
        camera, image_size=_SIZE, parameters=np.array([100.0, 100, 47, 35, -0.1, 0.02, 0, 0, 0]), covariance=None
    )
    native.write(folder / "small.yaml", CameraFile({"camera": CameraEntry(small)}))
    poses = views(camera, board, 6, rng=rng)
    seen = observe(camera, board, poses, rng=rng, noise_px=0.2)[0]
    for name in ("detections.csv", "corners.vnl"):
        detections.write(folder / name, seen)
    _make_rig_detections(folder, board, rng)
    steps = np.array([0.002, 0.001, 0.0])
    moving = [Pose(poses[0].rotation, poses[0].translation + k * steps) for k in range(8)]
    detections.write(folder / "moving.csv", observe(camera, board, moving, rng=rng, noise_px=0.2)[0])


def _make_rig_detections(folder: Path, board: Board, rng: np.random.Generator) -> None:
    """Write what two cameras saw of a board at once."""
    rig = cameras.read(folder / "rig.yaml")
    left = rig.cameras["left"].camera
    poses = views(left, board, 6, rng=rng)
    right_T_left = rig.transforms["right_T_left"].pose
    seen = []
    for name, each in (("left", poses), ("right", [right_T_left @ pose for pose in poses])):
        found = observe(rig.cameras[name].camera, board, each, rng=rng, noise_px=0.2)[0]
        seen += [replace(view, image=f"{k}.png", camera=name) for k, view in enumerate(found.views)]
    detections.write(folder / "rig.csv", replace(found, views=tuple(seen)))


def _make_with_commands(folder: Path, run: Callable[[list[str]], None]) -> None:
    """Write the good files that commands make of the others."""
    for name in ("poses.yaml", "poses.json", "poses.csv"):
        run(["pnp", f"{folder}/camera.yaml", f"{folder}/moving.csv", "-o", f"{folder}/{name}", "--quiet"])
    for name in ("path.yaml", "path.json"):
        run(["transform", "convert", "--trajectory", f"{folder}/path.csv", "-o", f"{folder}/{name}"])
    timed = [f"{folder}/poses.csv", "--fps", "10", "--quiet"]
    for name in ("track.csv", "track.json"):
        run(["track", *timed, "-o", f"{folder}/{name}"])
    for name, form in (
        ("opencv.yml", "opencv"),
        ("opencv.xml", "opencv"),
        ("opencv.json", "opencv"),
        ("ros.yaml", "ros"),
    ):
        run(["convert", f"{folder}/camera.yaml", f"{folder}/{name}", "--to", form, "--max-error", "5"])
    run(["convert", f"{folder}/small.yaml", f"{folder}/small.yml", "--to", "opencv"])
    run(["convert", f"{folder}/pair.yaml", f"{folder}/camchain.yaml", "--to", "kalibr"])
    run(["report", f"{folder}/detections.csv", "-o", f"{folder}/report.html", "--model", "opencv5"])
    run(["fit", f"{folder}/fit.csv", "--model", "poly:1", "-o", f"{folder}/fit.json"])
    run(["run", f"{folder}/pipeline.yaml"])
    run(["undistort", f"{folder}/small.yaml", f"{folder}/gray.png", "-o", f"{folder}/listed"])
    (folder / "listed/.camcal-output").replace(folder / ".camcal-output")
