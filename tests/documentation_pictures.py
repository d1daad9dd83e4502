"""The pictures of docs/, from what the commands of its pages write: python tests/documentation_pictures.py [PAGE…]

Every picture is of simulated images, reduced and with few colours, so that it has at most 150 kB.
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pypdfium2
from PIL import Image
from run_page import PAGES, PROJECT, README, command, run

FOLDER = PROJECT / "docs" / "pictures"
COLOURS = 64
MORE_COLOURS = {
    "industrial-camera",
    "readme-disparity",
    "readme-uncertainty",
    "stereo-depth",
    "tutorial-uncertainty",
}  # scales of colours
GAP = 8  # pixels between pictures side by side
Maker = Callable[[Path], Image.Image]


def one(path: str, width: int, cut: tuple[float, float, float, float] = (0, 0, 1, 1)) -> Maker:
    """Return what makes a picture of a file: the part `cut` (left, top, right, bottom, as shares), that wide."""
    return lambda folder: _loaded(folder / path, width, cut)


def row(width: int, *paths: str, cut: tuple[float, float, float, float] = (0, 0, 1, 1)) -> Maker:
    """Return what makes a picture of several files side by side, each that wide."""

    def make(folder: Path) -> Image.Image:
        parts = [_loaded(folder / path, width, cut) for path in paths]
        sheet = Image.new("RGB", (len(parts) * (width + GAP) - GAP, max(part.height for part in parts)), "white")
        for place, part in enumerate(parts):
            sheet.paste(part, (place * (width + GAP), (sheet.height - part.height) // 2))
        return sheet

    return make


def _loaded(path: Path, width: int, cut: tuple[float, float, float, float]) -> Image.Image:
    """Return a file as a picture of 8 bits, that wide; what has more bits fills the range."""
    whole = _printed(path) if path.suffix == ".pdf" else _opened(path)
    sides = np.array([whole.width, whole.height, whole.width, whole.height])
    part = whole.crop(tuple(int(side) for side in sides * cut))
    larger = part.width < width
    method = Image.Resampling.NEAREST if larger else Image.Resampling.LANCZOS
    return part.resize((width, round(width * part.height / part.width)), method)


def _printed(path: Path) -> Image.Image:
    """Return the first page of a PDF at 100 pixels an inch."""
    with pypdfium2.PdfDocument(path) as document:
        return document[0].render(scale=100 / 72).to_pil().convert("RGB")


def _opened(path: Path) -> Image.Image:
    with Image.open(path) as opened:
        return _of_16_bits(opened) if opened.mode.startswith("I") else opened.convert("RGB")


def _of_16_bits(image: Image.Image) -> Image.Image:
    values = np.asarray(image, dtype=float)
    return Image.fromarray(np.uint8(255 * (values - values.min()) / np.ptp(values))).convert("RGB")


PICTURES: dict[str, dict[str, Maker]] = {
    "readme": {
        "readme-corners": one("drawn/view0003_corners.png", 640),
        "readme-straight": row(400, "photos/images/view0014.png", "straight/view0014.png"),
        "readme-uncertainty": one("uncertainty.png", 640),
        "readme-disparity": one("disparity.tiff.vis.png", 640),
        "readme-cloud": one("cloud.png", 720),
    },
    "tutorial": {
        "tutorial-board": one("target.pdf", 700),
        "tutorial-corners": one("drawn/view0003_corners.png", 640),
        "tutorial-uncertainty": one("figures/projection_uncertainty.png", 640),
        "tutorial-straight": row(440, "phone/images/view0010.png", "straight/view0010.png"),
    },
    "action-camera": {
        "action-camera": row(300, "gopro/images/view0010.png", "straight/view0010.png", "wide/view0010.png"),
    },
    "fisheye-rig": {
        "fisheye-pair": row(400, "rig/images/left/view0005.png", "rig/images/right/view0005.png"),
        "fisheye-rig": one("rig.png", 800),
    },
    "industrial-camera": {
        "industrial-camera": row(
            *(290, "bayer/images/view0013.png", "colour/view0013.tiff", "straight/view0013.tiff"),
            cut=(0.84, 0.64, 0.96, 0.76),
        ),
    },
    "stereo-depth": {
        "stereo-depth": row(400, "scene/left/000.png", "disparity.png"),
        "stereo-cloud": one("cloud.png", 720),
    },
    "marker-tracking": {
        "marker-track": one("track.png", 800),
        "marker-poses": one("drawn.png", 640),
    },
}


def make(page: Path) -> None:
    """Run a page in an empty folder and write its pictures."""
    wanted = PICTURES.get(page.stem.lower(), {})
    with tempfile.TemporaryDirectory() as folder:
        if wanted:
            with command() as program:
                run(page.read_text(encoding="utf-8"), Path(folder), program)
        for name, maker in wanted.items():
            write(maker(Path(folder)), name)


def write(picture: Image.Image, name: str) -> None:
    """Write a picture with few colours."""
    FOLDER.mkdir(exist_ok=True)
    colours = 256 if name in MORE_COLOURS else COLOURS
    few = picture.quantize(colours, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    few.save(FOLDER / f"{name}.png", optimize=True)


if __name__ == "__main__":
    named = [Path(name) for name in sys.argv[1:]]
    for each in named or [README, *PAGES]:
        make(each)
