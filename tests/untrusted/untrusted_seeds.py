"""Good files of every kind that camcal reads, and for each the command lines that read it.

A command line holds FILE where the damaged copy goes, OUT where results go, and GOOD/name for an undamaged file.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from camcal.formats import cameras, detections, disparity_sidecar, native, pointclouds
from camcal.formats import disparity as disparity_map
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.disparity_sidecar import Sidecar
from camcal.geometry.pose import Pose
from camcal.images.save import save
from camcal.raw.dng import write_dng
from camcal.raw.mosaic import Mosaic
from camcal.simulate.scene import observe, views
from camcal.stereo.geometry import StereoGeometry
from camcal.stereo.points.frames import VertexStream, vertex_type
from camcal.targets.board import Board

FILE, OUT, GOOD = "FILE", "OUT", "GOOD/"

_BOARD = "chessboard:7x5:25mm"
_SIZE = (96, 72)  # width, height
_NUMBERS = "--fx 100 --cx 47 --cy 35 --baseline 0.1 --outliers none"
_SAMPLES = Path(__file__).parents[2] / "sample_configs"


@dataclass(frozen=True)
class Reader:
    """A file by its name among the good ones, the command line that reads it, and files it needs beside it."""

    file: str
    command: str
    beside: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        verb = " ".join(word for word in self.command.split()[:2] if word.isalpha() and word.islower())
        return f"{verb} {self.file}"

    def arguments(self, damaged: Path, good: Path, output: Path) -> list[str]:
        """Return the command line with the paths in their places."""
        places = {FILE: str(damaged), OUT: str(output)}
        words = self.command.split()
        return [f"{good}/{word[len(GOOD) :]}" if word.startswith(GOOD) else places.get(word, word) for word in words]


_IMAGES = ("gray.png", "colour.png", "deep.png", "gray.jpg", "colour.jpg", "colour.tiff", "deep.tiff", "float.tiff")
_OTHER_IMAGES = ("colour.bmp", "gray.pgm", "colour.ppm", "colour.webp", "gray.jp2", "gray.npy")
_MAPS = ("map.pfm", "map.tiff", "map.png", "map.npy", "map.npz", "map.exr")
_CLOUDS = ("cloud.ply", "text.ply", "cloud.pcd", "text.pcd", "cloud.xyz", "cloud.npz", "cloud.glb", "cloud.las")
_LONG_CLOUDS = ("cloud.laz",)
_MOSAICS = ("mosaic.png", "mosaic.tiff", "mosaic.pgm", "mosaic.npy")
_TRAJECTORIES = ("path.tum", "path.csv", "path.yaml", "path.json", "track.csv", "track.json", "kitti.txt")
_POSES = ("pose.txt", "frames.yaml", "poses.yaml", "poses.json", "poses.csv")

READERS: Sequence[Reader] = (
    *(Reader(name, f"detect FILE --board {_BOARD} -o OUT/d.csv --jobs 1") for name in (*_IMAGES, *_OTHER_IMAGES)),
    *(Reader(name, "undistort GOOD/small.yaml FILE -o OUT --jobs 1") for name in (*_IMAGES, "clip.avi")),
    Reader("gray.png", "stereo check FILE GOOD/right.png -o OUT"),
    Reader(
        "colour.tiff", f"stereo disparity FILE GOOD/right.png {_NUMBERS.replace('--outliers none', '')} -o OUT/d.pfm"
    ),
    Reader("clip.avi", f"detect FILE --board {_BOARD} -o OUT/d.csv --jobs 1"),
    *(Reader(name, "demosaic FILE --pattern RGGB -o OUT/d.png --algorithm half --trust-pattern") for name in _MOSAICS),
    *(Reader(name, "inspect FILE --pattern RGGB") for name in _MOSAICS),
    Reader("negative.dng", "demosaic FILE -o OUT/d.png --algorithm half --trust-pattern"),
    Reader("negative.dng", "inspect FILE"),
    Reader("dump.raw", "demosaic FILE --format BayerRG12p --size 96x72 -o OUT/d.png --trust-pattern"),
    Reader("dump.raw", "inspect FILE"),
    Reader("matrix.txt", "demosaic GOOD/negative.dng --colour FILE -o OUT/d.png --trust-pattern"),
    Reader("bad.txt", "demosaic GOOD/negative.dng --bad-pixels FILE -o OUT/d.png --trust-pattern"),
    Reader("bad.npy", "demosaic GOOD/negative.dng --bad-pixels FILE -o OUT/d.png --trust-pattern"),
    *(Reader(name, f"stereo cloud FILE {_NUMBERS} -o OUT/c.ply") for name in _MAPS),
    *(Reader(name, "stereo eval FILE GOOD/map.pfm -o OUT/e.png") for name in ("map.pfm", "map.png")),
    Reader("map.pfm.json", "stereo cloud map.pfm --outliers none -o OUT/c.ply", ("map.pfm",)),
    Reader("map.pfm.json", "view map.pfm -o OUT/v.html", ("map.pfm",)),
    Reader("calib.txt", "stereo cloud GOOD/bare.pfm GOOD/gray.png FILE --outliers none -o OUT/c.ply"),
    Reader("kitti_calib.txt", "stereo cloud GOOD/bare.pfm GOOD/gray.png FILE --camera P0 --outliers none -o OUT/c.ply"),
    *(Reader(name, "view FILE -o OUT/v.html") for name in (*_CLOUDS, *_LONG_CLOUDS)),
    *(Reader(name, "view FILE -o OUT/v.png --size 64x48") for name in _CLOUDS[:6]),
    *(Reader(name, "transform points FILE --with GOOD/pose.txt -o OUT/p.ply") for name in (*_CLOUDS, *_LONG_CLOUDS)),
    Reader("points.csv", "transform points FILE --with GOOD/pose.txt -o OUT/p.csv"),
    *(Reader(name, "smooth FILE -o OUT/s.csv --q 1,1 --sigma 0.01,0.01") for name in _TRAJECTORIES),
    *(
        Reader(name, "smooth FILE --evaluate GOOD/path.tum --align none --q 1,1 --sigma 0.01,0.01")
        for name in ("path.tum", "euroc.csv")
    ),
    *(Reader(name, "transform convert --trajectory FILE -o OUT/t.csv") for name in (*_TRAJECTORIES, "euroc.csv")),
    Reader("series.csv", "smooth FILE -o OUT/s.csv --q 1 --sigma 0.1"),
    *(Reader(name, "transform check FILE") for name in _POSES),
    *(Reader(name, "transform average --robust FILE FILE") for name in _POSES),
    Reader("frames.yaml", "transform chain FILE --to a --from c"),
    Reader("poses.csv", "track FILE --fps 10 -o OUT/t.csv"),
    Reader("camera.yaml", "inspect FILE"),
    Reader("camera.yaml", "optics FILE"),
    Reader("small.yaml", "undistort FILE GOOD/gray.png -o OUT --jobs 1"),
    Reader("rig.yaml", "inspect FILE"),
    Reader("detections.csv", "calibrate FILE -o OUT/c.yaml --model opencv5 --jobs 1"),
    Reader("detections.csv", "pnp GOOD/camera.yaml FILE -o OUT/p.yaml"),
    Reader(
        "corners.vnl", f"calibrate FILE --board {_BOARD} --image-size 1280x720 -o OUT/c.yaml --model opencv5 --jobs 1"
    ),
    *(
        Reader(f"points.{kind}", "pnp GOOD/camera.yaml --points FILE -o OUT/p.yaml")
        for kind in ("pnp.csv", "yaml", "json")
    ),
    Reader("tags.yaml", "pnp GOOD/small.yaml GOOD/gray.png --tags FILE -o OUT/p.yaml --jobs 1"),
    Reader("board.yaml", "detect GOOD/gray.png --board FILE -o OUT/d.csv --jobs 1"),
    Reader("board.yaml", "board FILE -o OUT/b.svg"),
    Reader("fit.csv", "fit FILE --model poly:1 --plot OUT/f.png"),
    Reader("settings.yaml", f"detect GOOD/gray.png --board {_BOARD} -o OUT/d.csv --jobs 1 --config FILE"),
    Reader("pixels.csv", "undistort GOOD/camera.yaml --points FILE -o OUT/p.csv"),
)


def make(folder: Path, run: Callable[[list[str]], None]) -> None:
    """Write every good file into `folder`; run: a function that runs a command line and raises if it fails."""
    rng = np.random.default_rng(3)
    _make_images(folder, rng)
    _make_raw(folder, rng)
    _make_maps_and_clouds(folder, rng)
    _make_texts(folder)
    for name, sample in (("camera.yaml", "cameras/webcam.yaml"), ("rig.yaml", "cameras/stereo_rig.yaml")):
        (folder / name).write_bytes((_SAMPLES / sample).read_bytes())
    (folder / "tags.yaml").write_bytes((_SAMPLES / "tags/cube.yaml").read_bytes())
    (folder / "board.yaml").write_bytes((_SAMPLES / "boards/chessboard_25mm.yaml").read_bytes())
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
    for name in (*_MAPS, "bare.pfm"):
        disparity_map.write(folder / name, map_)
    geometry = StereoGeometry(100.0, 100.0, 47.0, 35.0, 0.1)
    disparity_sidecar.write(folder / "map.pfm", Sidecar(1.0, "inf", geometry, searched=(0, 32)))
    vertices = np.zeros(60, vertex_type(colour=True, normals=True))
    for name in vertices.dtype.names or ():
        vertices[name] = rng.random(60) * (200 if vertices.dtype[name].kind == "u" else 1)
    for name in (*_CLOUDS, *_LONG_CLOUDS):
        stream = VertexStream(len(vertices), vertices.dtype, [vertices])
        pointclouds.write(folder / name, stream, ascii_text=name.startswith("text"))


def _make_texts(folder: Path) -> None:
    texts = {
        "calib.txt": "cam0=[100 0 47; 0 100 35; 0 0 1]\ncam1=[100 0 47; 0 100 35; 0 0 1]\ndoffs=0\nbaseline=100\n"
        "width=96\nheight=72\nndisp=32\n",
        "kitti_calib.txt": "".join(f"P{k}: 100 0 47 {-10 * (k % 2)} 0 100 35 0 0 0 1 0\n" for k in range(4)),
        "points.csv": "x,y,z,sxx,sxy,sxz,syy,syz,szz,name\n" + "".join(f"{k},1,2,1,0,0,1,0,1,p{k}\n" for k in range(9)),
        "path.tum": "# frames: w_T_c\n" + "".join(f"{k * 0.1:.1f} {k * 0.01} 0 1 0 0 0 1\n" for k in range(30)),
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
    steps = np.array([0.002, 0.001, 0.0])
    moving = [Pose(poses[0].rotation, poses[0].translation + k * steps) for k in range(8)]
    detections.write(folder / "moving.csv", observe(camera, board, moving, rng=rng, noise_px=0.2)[0])


def _make_with_commands(folder: Path, run: Callable[[list[str]], None]) -> None:
    """Write the good files that commands make of the others."""
    for name in ("poses.yaml", "poses.json", "poses.csv"):
        run(["pnp", f"{folder}/camera.yaml", f"{folder}/moving.csv", "-o", f"{folder}/{name}", "--quiet"])
    for name in ("path.yaml", "path.json"):
        run(["transform", "convert", "--trajectory", f"{folder}/path.csv", "-o", f"{folder}/{name}"])
    timed = [f"{folder}/poses.csv", "--fps", "10", "--quiet"]
    for name in ("track.csv", "track.json"):
        run(["track", *timed, "-o", f"{folder}/{name}"])
