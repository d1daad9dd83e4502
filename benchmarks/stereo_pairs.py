"""Rectified pairs with a known disparity, from folders in the layouts in which they are published."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from camcal.formats import disparity
from camcal.stereo.truth import visible_in_both

MIDDLEBURY_SCALES = {"venus": 8}  # 2001; the sets of 2003 have 4
STEP = 16  # OpenCV searches multiples of it


@dataclass(frozen=True)
class Pair:
    """A pair and its truth.

    left, right: (H, W) or (H, W, 3) BGR, uint8. truth: (H, W) float32 pixels, NaN where unknown. visible: (H, W) bool,
    what both cameras see. count: disparities to search, from 0.
    """

    name: str
    left: np.ndarray
    right: np.ndarray
    truth: np.ndarray
    visible: np.ndarray
    count: int


def pairs_in(folder: Path, shift: float) -> Iterator[Pair]:
    """Yield the pairs of a folder, or of the folders in it; shift: added to truths that are whole numbers of pixels."""
    for reads, sign in LAYOUTS.items():
        if (folder / sign).exists():
            for pair in reads(folder):
                whole = np.isfinite(pair.truth) & (pair.truth == np.rint(pair.truth))
                rounded = np.array_equal(whole, np.isfinite(pair.truth))
                yield replace(pair, truth=pair.truth + shift) if rounded else pair
            return
    inner = [path for path in sorted(folder.iterdir()) if path.is_dir()] if folder.is_dir() else []
    for path in inner:
        yield from pairs_in(path, shift)


def middlebury2003(folder: Path) -> Iterator[Pair]:
    """Middlebury 2001 and 2003: im2, im6, disp2, disp6, 0 for unknown."""
    scale = next((scale for name, scale in MIDDLEBURY_SCALES.items() if name in folder.name.lower()), 4)
    truth, right_truth = (known(disparity.read(folder / f"disp{eye}.png", scale).values) for eye in (2, 6))
    left, right = (image(folder / f"im{eye}.png") for eye in (2, 6))
    yield Pair(folder.name, left, right, truth, visible_in_both(truth, right_truth), up(np.nanmax(truth) + 1))


def middlebury2014(folder: Path) -> Iterator[Pair]:
    """Middlebury 2014 and later, ETH3D: im0, im1, disp0GT.pfm (or disp0.pfm), mask0nocc.png, calib.txt with ndisp."""
    truth = known(disparity.read(first_of(folder, "disp0GT.pfm", "disp0.pfm")).values)
    mask = folder / "mask0nocc.png"
    visible = cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE) == 255 if mask.exists() else unoccluded(truth)
    yield Pair(
        folder.name, image(folder / "im0.png"), image(folder / "im1.png"), truth, visible, declared(folder, truth)
    )


def skimage(folder: Path) -> Iterator[Pair]:
    """The motorcycle that scikit-image ships: motorcycle_left.png, motorcycle_right.png, motorcycle_disp.npz."""
    left, right = (image(folder / f"motorcycle_{eye}.png") for eye in ("left", "right"))
    with np.load(folder / "motorcycle_disp.npz") as archive:
        truth = known(archive[archive.files[0]])
    yield Pair("motorcycle", left, right, truth, unoccluded(truth), up(np.nanmax(truth) + 1))


def slambook(folder: Path) -> Iterator[Pair]:
    """The road of slambook2: ch5/stereo/left.png and right.png, ch8/disparity.png, whose disparities were computed."""
    truth = known(disparity.read(folder / "ch8" / "disparity.png", 1).values)
    left, right = (image(folder / "ch5" / "stereo" / f"{eye}.png") for eye in ("left", "right"))
    yield Pair("slambook2", left, right, truth, unoccluded(truth), up(np.nanmax(truth) + 1))


def opencv_sample(folder: Path) -> Iterator[Pair]:
    """The aloe of OpenCV's samples (Middlebury 2006): aloeL.jpg, aloeR.jpg, aloeGT.png."""
    left, right = (image(folder / f"aloe{eye}.jpg") for eye in "LR")
    truth = known(image(folder / "aloeGT.png").astype(np.float32))
    yield Pair("aloe", left, right, truth, unoccluded(truth), up(np.nanmax(truth) + 1))


def simulated(folder: Path) -> Iterator[Pair]:
    """What `camcal simulate --stereo` writes."""
    for path in sorted((folder / "left").glob("*.png")):
        truth = known(disparity.read(folder / "disparity" / f"{path.stem}.pfm").values)
        visible = image(folder / "visible" / path.name) == 255
        right = image(folder / "right" / path.name)
        yield Pair(f"{folder.name}/{path.stem}", image(path), right, truth, visible, up(np.nanmax(truth) + 1))


LAYOUTS = {
    middlebury2003: "disp2.png",
    middlebury2014: "im0.png",
    skimage: "motorcycle_disp.npz",
    slambook: "ch8/disparity.png",
    opencv_sample: "aloeGT.png",
    simulated: "visible",
}


def unoccluded(truth: np.ndarray) -> np.ndarray:
    """Return which pixels (H, W) nothing nearer hides in the right image, by the left truth, each at the nearest pixel.

    Published figures of pairs with one truth rest on it. Where a surface is stretched in the right image, some of what
    lies behind it passes as visible: it asks for more than `camcal stereo eval` does.
    """
    width = truth.shape[1]
    columns = np.arange(width) - truth
    inside = (columns >= 0) & (columns <= width - 1)
    places = np.where(inside, np.rint(columns), 0).astype(int)
    rows = np.broadcast_to(np.arange(len(truth))[:, None], truth.shape)
    nearest = np.full(truth.shape, -np.inf)
    np.maximum.at(nearest, (rows[inside], places[inside]), truth[inside])
    return inside & (truth >= np.take_along_axis(nearest, places, axis=1) - 1)


def image(path: Path) -> np.ndarray:
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None:
        raise SystemExit(f"{path}: cannot be read")
    return pixels[..., :3] if pixels.ndim == 3 else pixels


def known(values: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(values) & (values > 0), values, np.nan).astype(np.float32)


def first_of(folder: Path, *names: str) -> Path:
    return next((folder / name for name in names if (folder / name).exists()), folder / names[0])


def declared(folder: Path, truth: np.ndarray) -> int:
    """Return how many disparities calib.txt says there are, or the truth has."""
    text = (folder / "calib.txt").read_text() if (folder / "calib.txt").exists() else ""
    counts = [int(line.partition("=")[2]) for line in text.splitlines() if line.startswith("ndisp=")]
    return up(counts[0] if counts else np.nanmax(truth) + 1)


def up(count: float) -> int:
    return int(-(-count // STEP)) * STEP
