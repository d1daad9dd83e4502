"""One pair of `camcal stereo run`: from two images to a cloud and a page, with all that is written on the way."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from camcal import files
from camcal.arrays import PixelArray
from camcal.errors import InsufficientData, InvalidInput
from camcal.images.load import load
from camcal.images.save import save
from camcal.messages import Message
from camcal.progress import Collected
from camcal.report import cloud_view
from camcal.report.cloud_scene import gather
from camcal.report.cloud_view import Start
from camcal.report.colour_scale import paint_of
from camcal.stereo.pair.pair_check import PairCheck
from camcal.tasks.stereo.cloud import CloudReport, source_of_match, write_points
from camcal.tasks.stereo.cloud_options import CloudOptions
from camcal.tasks.stereo.options import DisparityOptions
from camcal.tasks.stereo.pair_matching import PairImages, match_images, rectified_pair
from camcal.tasks.stereo.rig_pair import RigPair
from camcal.tasks.stereo.run_options import RunOptions
from camcal.tasks.stereo.stereo_check import check_images
from camcal.tasks.stereo.stereo_disparity import Figures, MapFiles, for_png, write_map
from camcal.tasks.stereo.view import MOST_POINTS, PAGE, cloud_in

_PICTURE, _MAP, _PAGE = ".png", ".tiff", ".html"


class Capture(NamedTuple):
    """Two images that were taken together, as the rig orders its cameras; frames: of videos, else None for both."""

    left: Path
    right: Path
    name: str
    frames: tuple[PixelArray, PixelArray] | None = None


class RunFiles(NamedTuple):
    """What is written of a pair."""

    left: Path
    right: Path
    map: Path
    cloud: Path
    page: Path

    @classmethod
    def of(cls, folder: Path, name: str, cloud_type: str) -> "RunFiles":
        """Return the files of a pair in the folder of a run."""
        left, right = (folder / "rectified" / side / f"{name}{_PICTURE}" for side in ("left", "right"))
        cloud = folder / "clouds" / f"{name}.{cloud_type}"
        return cls(left, right, folder / "disparity" / f"{name}{_MAP}", cloud, folder / "views" / f"{name}{_PAGE}")

    def every(self) -> Iterator[Path]:
        """Yield all of them, those beside the map among them."""
        yield from (self.left, self.right, self.cloud, self.page)
        yield from MapFiles.beside(self.map)


@dataclass(frozen=True, eq=False)
class RunPair:
    """What became of a pair: its check (None if too little of it can be matched), its map, its cloud, and its page.

    page: None for an empty cloud. warnings: what is weak; failures: why the pair or its map cannot be used.
    """

    capture: Capture
    files: RunFiles
    check: PairCheck | None
    figures: Figures
    cloud: CloudReport
    page: Path | None
    warnings: tuple[Message, ...]
    failures: tuple[Message, ...]


@dataclass(frozen=True, eq=False)
class PairRun:
    """How pairs are run: their rectification, made once for all of them, and the options.

    jobs: threads for one pair.
    """

    rig: RigPair
    options: RunOptions
    jobs: int | None = 1

    def __call__(self, capture: Capture) -> RunPair:
        """Return what became of a pair; raises InvalidInput and FileError."""
        options, places = self.options, RunFiles.of(self.options.output, capture.name, self.options.clouds)
        images = self._rectified(capture)
        save(places.left, for_png(images.left))
        save(places.right, for_png(images.right))
        images = replace(images, image=places.left)
        check, doubts = _checked(images)
        found = match_images(images, options.matching, jobs=self.jobs)
        own = DisparityOptions((), (), places.map, matching=options.matching)
        matched = write_map(images, found, MapFiles.beside(places.map), own, None)
        heard = Collected()
        how = CloudOptions(places.map, places.cloud, points=options.points, vertices=options.vertices, jobs=self.jobs)
        cloud = write_points(how, source_of_match(images, found), heard)
        page = _write_page(places, capture.name) if cloud.points else None
        warnings = (*doubts, *matched.warnings, *heard.warnings)
        named = capture._replace(frames=None)  # frames would be kept for as long as the report is
        figures = None if check is None else check.figures()
        return RunPair(named, places, figures, matched.figures, cloud, page, warnings, matched.failures)

    def _rectified(self, capture: Capture) -> PairImages:
        sources = (capture.left, capture.right)
        pixels = capture.frames or (load(capture.left).pixels, load(capture.right).pixels)
        if self.rig.rectification.swapped:
            sources, pixels = sources[::-1], pixels[::-1]
        return rectified_pair(sources, pixels[0], pixels[1], self.rig)


def _checked(images: PairImages) -> tuple[PairCheck | None, tuple[Message, ...]]:
    """Return the check of rectified images, or why there is none; what is wrong with the pair the matching says too."""
    try:
        return check_images(images), ()
    except (InsufficientData, InvalidInput) as error:
        return None, (Message("rows_not_checked", f"row offsets not checked: {error.message}"),)


def _write_page(places: RunFiles, title: str) -> Path:
    scene = gather(cloud_in(places.cloud), MOST_POINTS[PAGE])
    files.write_text(places.page, cloud_view.page(scene, title, Start(paint_of(scene, None).name)))
    return places.page
