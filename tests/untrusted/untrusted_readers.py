"""The command lines that read each of the good files of `untrusted_seeds`.

A command line holds FILE where the damaged copy goes, HERE for its folder, OUT where results go, and GOOD/name for an
undamaged file.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

FILE, OUT, HERE, GOOD = "FILE", "OUT", "HERE", "GOOD/"

_BOARD = "chessboard:7x5:25mm"
_NUMBERS = "--fx 100 --cx 47 --cy 35 --baseline 0.1 --outliers none"


@dataclass(frozen=True)
class Reader:
    """A file by its name among the good ones, the command line that reads it, and files it needs beside it.

    keeps: what was done before something failed stays, as of the steps of a pipeline.
    """

    file: str
    command: str
    beside: tuple[str, ...] = ()
    keeps: bool = False

    @property
    def verb(self) -> str:
        """The command, with that of its group before it."""
        group, *_ = words = self.command.split()[:2]
        return " ".join(words if group in ("stereo", "transform") else [group])

    @property
    def name(self) -> str:
        return f"{self.verb} {self.file}"

    def arguments(self, damaged: Path, good: Path, output: Path) -> list[str]:
        """Return the command line with the paths in their places."""
        places = {FILE: str(damaged), HERE: str(damaged.parent), OUT: str(output)}
        words = self.command.split()
        return [f"{good}/{word[len(GOOD) :]}" if word.startswith(GOOD) else places.get(word, word) for word in words]


_IMAGES = ("gray.png", "colour.png", "deep.png", "gray.jpg", "colour.jpg", "colour.tiff", "deep.tiff", "float.tiff")
_OTHER_IMAGES = ("colour.bmp", "gray.pgm", "colour.ppm", "colour.webp", "gray.jp2", "gray.npy")
MAPS = ("map.pfm", "map.tiff", "map.png", "map.npy", "map.npz", "map.exr")
CLOUDS = ("cloud.ply", "text.ply", "cloud.pcd", "text.pcd", "cloud.xyz", "cloud.npz", "cloud.glb", "cloud.las")
LONG_CLOUDS = ("cloud.laz",)
_MOSAICS = ("mosaic.png", "mosaic.tiff", "mosaic.pgm", "mosaic.npy")
_TRAJECTORIES = ("path.tum", "path.csv", "path.yaml", "path.json", "track.csv", "track.json", "kitti.txt")
_POSES = ("pose.txt", "frames.yaml", "poses.yaml", "poses.json", "poses.csv")
_CAMERAS = ("opencv.yml", "opencv.xml", "opencv.json", "ros.yaml", "camchain.yaml", "fisheye.yaml", "pair.yaml")
_PAIRS = ("pair.yaml", "camchain.yaml")
_BOARDS = ("board.yaml", "charuco.yaml", "circles.yaml", "kalibr_target.yaml")
_DRAWN = ("camera.yaml", "rig.yaml", "detections.csv", "poses.yaml", "path.tum", "track.csv", "map.pfm", "fit.json")
_SENSOR = "-o OUT/s.yaml --pattern MONO --exposure 0.01 --dark-exposure 0.01 --jobs 1"
_DEMOSAIC = "demosaic GOOD/mosaic.png -o OUT/d.png --pattern RGGB --trust-pattern --jobs 1"

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
    *(Reader(name, f"stereo cloud FILE {_NUMBERS} -o OUT/c.ply") for name in MAPS),
    *(Reader(name, "stereo eval FILE GOOD/map.pfm -o OUT/e.png") for name in ("map.pfm", "map.png")),
    Reader("map.pfm.json", "stereo cloud map.pfm --outliers none -o OUT/c.ply", ("map.pfm",)),
    Reader("map.pfm.json", "view map.pfm -o OUT/v.html", ("map.pfm",)),
    Reader("calib.txt", "stereo cloud GOOD/bare.pfm GOOD/gray.png FILE --outliers none -o OUT/c.ply"),
    Reader("kitti_calib.txt", "stereo cloud GOOD/bare.pfm GOOD/gray.png FILE --camera P0 --outliers none -o OUT/c.ply"),
    *(Reader(name, "view FILE -o OUT/v.html") for name in (*CLOUDS, *LONG_CLOUDS)),
    *(Reader(name, "view FILE -o OUT/v.png --size 64x48") for name in CLOUDS[:6]),
    *(Reader(name, "transform points FILE --with GOOD/pose.txt -o OUT/p.ply") for name in (*CLOUDS, *LONG_CLOUDS)),
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
    *(Reader(name, "convert FILE OUT/c.yaml --to camcal") for name in _CAMERAS),
    *(Reader(name, "inspect FILE") for name in _CAMERAS),
    *(Reader(name, "stereo rectify FILE -o OUT --size 96x72 --jobs 1") for name in _PAIRS),
    Reader("camera.yaml", "convert FILE OUT/c.xml OUT/r.yaml --to opencv"),
    Reader("pair.yaml", "convert FILE OUT/k.yaml --to kalibr"),
    Reader("small.yml", "undistort FILE GOOD/gray.png -o OUT --jobs 1"),
    Reader("gray.png", "stereo rectify GOOD/pair.yaml FILE GOOD/right.png -o OUT --jobs 1"),
    Reader("clip.avi", "stereo rectify GOOD/pair.yaml FILE GOOD/clip.avi -o OUT --jobs 1"),
    Reader("gray.png", "stereo run GOOD/pair.yaml FILE GOOD/right.png -o OUT --jobs 1"),
    Reader("pair.yaml", "stereo run FILE GOOD/gray.png GOOD/right.png -o OUT --jobs 1"),
    Reader("pair.yaml", "stereo disparity GOOD/gray.png GOOD/right.png FILE -o OUT/d.pfm --jobs 1"),
    *(Reader(name, f"stereo check FILE {GOOD}right.png --jobs 1") for name in ("deep.tiff", "colour.jpg", "gray.npy")),
    Reader("visible.png", "stereo eval GOOD/map.pfm GOOD/map.pfm --mask FILE"),
    Reader("calib.txt", "stereo eval GOOD/map.pfm GOOD/map.pfm FILE"),
    *(Reader(name, "board FILE -o OUT/b.pdf") for name in _BOARDS),
    *(Reader(name, "detect GOOD/gray.png --board FILE -o OUT/d.csv --jobs 1") for name in _BOARDS[1:]),
    *(Reader(name, f"pnp GOOD/small.yaml FILE --board {_BOARD} -o OUT/p.yaml --jobs 1") for name in _IMAGES[::3]),
    Reader("opencv.yml", "pnp FILE GOOD/detections.csv -o OUT/p.csv"),
    Reader("clip.avi", f"track GOOD/small.yaml FILE --board {_BOARD} -o OUT/t.csv --jobs 1"),
    *(Reader(name, "track FILE --fps 10 -o OUT/t.json") for name in ("poses.yaml", "poses.json")),
    Reader("times.csv", "track GOOD/poses.csv --timestamps FILE -o OUT/t.csv"),
    Reader("rig.csv", "rig FILE -o OUT/r.yaml --model opencv5 --jobs 1"),
    Reader("rig.csv", "stereo calibrate FILE -o OUT/r.yaml --model opencv5 --jobs 1"),
    Reader("detections.csv", "report FILE -o OUT/r.html --model opencv5"),
    *(Reader(name, "report FILE -o OUT/r.html") for name in ("camera.yaml", "rig.yaml", "ros.yaml", "camchain.yaml")),
    Reader("report.html", "rerun FILE -o OUT"),
    *(Reader(name, "plot FILE -o OUT") for name in _DRAWN),
    Reader("path.tum", "plot GOOD/path.tum --reference FILE -o OUT"),
    Reader("flat_1.png", f"sensor HERE --dark GOOD/darks {_SENSOR}", ("flat_2.png",)),
    Reader("flat_1.tiff", f"sensor HERE --dark GOOD/darks {_SENSOR}", ("flat_2.tiff",)),
    Reader("flat_1.png", f"sensor GOOD/flats --dark HERE {_SENSOR}", ("flat_2.png",)),
    Reader("mosaic.png", f"{_DEMOSAIC} --flat FILE"),
    Reader("mosaic.tiff", f"{_DEMOSAIC} --dark FILE"),
    Reader("small.yaml", f"simulate {_BOARD} FILE -o OUT --views 1"),
    Reader("board.yaml", "simulate FILE GOOD/small.yaml -o OUT --views 1"),
    Reader("frames.yaml", "transform eval a_T_b*b_T_c --frames FILE"),
    *(Reader(name, "transform invert FILE -o OUT/i.yaml") for name in ("frames.yaml", "pose.txt")),
    Reader("line.txt", "transform compose FILE GOOD/line.txt --form quat:xyzw"),
    Reader("line.txt", "transform convert FILE --form quat:xyzw --as matrix"),
    Reader("opencv.xml", "optics FILE"),
    Reader("calibrate.yaml", "calibrate GOOD/detections.csv -o OUT/c.yaml --config FILE"),
    Reader("disparity.yaml", "stereo disparity GOOD/gray.png GOOD/right.png -o OUT/d.pfm --config FILE"),
    Reader("undistort.yaml", "undistort GOOD/small.yaml GOOD/gray.png -o OUT --config FILE"),
    Reader(".camcal-output", "undistort GOOD/small.yaml GOOD/gray.png -o HERE --jobs 1"),
    Reader(".camcal-output", "undistort GOOD/small.yaml GOOD/gray.png -o HERE --jobs 1 --resume"),
    *[Reader("pipeline.yaml", "run FILE --jobs 1", ("small.yaml", "gray.png"), keeps=True)] * 2,
    Reader(
        ".pipeline.state.json", "run pipeline.yaml --jobs 1", ("pipeline.yaml", "small.yaml", "gray.png"), keeps=True
    ),
)
