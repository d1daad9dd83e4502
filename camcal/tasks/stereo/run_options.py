"""The options of `camcal stereo run`."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated

from camcal.errors import InvalidInput
from camcal.options import INPUT, OUTPUT, Argument, Option, OptionsRecord, Without
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.stereo.options import MatchOptions
from camcal.stereo.rectify.options import RectifiedViewOptions
from camcal.tasks.options import CAMERA_SUFFIXES, FOLDER, Jobs, Overwrite, Recursive, output_option
from camcal.tasks.rigs.options import RigSettings
from camcal.tasks.stereo.cloud_options import PointOptions, VertexOptions
from camcal.tasks.stereo.options import Force, PairNames

CLOUD_TYPES = ("ply", "pcd", "xyz", "npz", "glb", "las", "laz")
_READING = ("pattern", "algorithm", *(f"layout.{each}" for each in ("format", "size", "stride", "offset", "endian")))
_CALIBRATION = (
    "output",
    "tolerance",
    "timing.source",
    "timing.fps",
    "timing.unit",
    "lenses",
    "guess",
    "free_corners",
    "max_rejected",
    "report",
    "image_size",
    "recursive",
    "jobs",
    *(f"batch.{each.name}" for each in fields(BatchOptions)),
    *(f"reading.{each}" for each in (*_READING, "layout.align")),
    "frames.most",
    "frames.every",
    "frames.whole",
    "refine",
    "motion",
    "mixed_sizes",
    "save_detections",
    "max_uncertainty",
    "figures.folder",
    "figures.kind",
    "overwrite",
)  # of the rig's settings, what `stereo calibrate` is for


@dataclass(frozen=True)
class RunOptions(OptionsRecord):
    """A rig and pairs, or pairs of a board to calibrate it with; which pairs become clouds, and how.

    inputs: RIG LEFT RIGHT, or LEFT RIGHT with a board. scene: other images of the cameras than those of the board.
    every: use of every so many pairs one. clouds: type of the files.
    """

    inputs: Annotated[
        tuple[str, ...],
        Argument(
            "A rig file and the images of its cameras, each a file, a folder, a quoted glob or a video; without the "
            "rig file images of a board (--board), which the cameras are calibrated with first.",
            metavar="[RIG] LEFT RIGHT",
            required=True,
        ),
    ] = ()
    output: Annotated[Path, output_option("Folder for all results.", FOLDER, "DIR", required=True)] = Path()
    scene: Annotated[
        tuple[str, ...] | None,
        Option(
            "Images of the scene, where LEFT and RIGHT show a board; by default the scene is what is behind the board.",
            metavar="LEFT RIGHT",
            group=INPUT,
            values=2,
        ),
    ] = None
    every: Annotated[
        int, Option("Use one of every N pairs; of videos, one of every N frames.", metavar="N", group=INPUT, least=1)
    ] = 1
    cameras: PairNames = None
    settings: Annotated[RigSettings, Without(_CALIBRATION)] = field(default_factory=RigSettings)
    view: RectifiedViewOptions = field(default_factory=RectifiedViewOptions)
    matching: MatchOptions = field(default_factory=MatchOptions)
    points: Annotated[PointOptions, Without(("mask", "sigma_disparity"))] = field(default_factory=PointOptions)
    vertices: Annotated[VertexOptions, Without(("organised", "pose", "ascii_text"))] = field(
        default_factory=VertexOptions
    )
    clouds: Annotated[
        str,
        Option(f"Type of the clouds: {', '.join(CLOUD_TYPES)}.", metavar="TYPE", group=OUTPUT, choices=CLOUD_TYPES),
    ] = "ply"
    force: Force = False
    recursive: Recursive = False
    jobs: Jobs = None
    batch: BatchOptions = DEFAULT_BATCH
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.inputs:
            return
        if len(self.inputs) not in (2, 3):
            raise InvalidInput(f"expected [RIG] LEFT RIGHT, found {len(self.inputs)} arguments: quote globs")
        if self.rig is not None and len(self.inputs) == 2:
            raise InvalidInput(f"expected LEFT RIGHT after the rig file, found {self.inputs[1]} alone")
        if len(self.inputs) == 3 and self.rig is None:
            raise InvalidInput(f"a rig file ends in {', '.join(CAMERA_SUFFIXES)}", where=self.inputs[0])
        if self.rig is None and self.settings.board is None:
            raise InvalidInput(
                "no rig file: camcal stereo calibrate LEFT RIGHT --board BOARD -o rig.yaml makes one; put it before "
                "LEFT RIGHT, or give --board if they show one"
            )
        if self.rig is not None and self.settings.board is not None:
            raise InvalidInput("--board calibrates the cameras, which the rig file is for already: leave one out")
        if self.rig is not None and self.scene is not None:
            raise InvalidInput("--scene goes with --board; with a rig file LEFT and RIGHT are the scene")
        if self.vertices.frame == "enu":
            raise InvalidInput("--frame enu needs a pose for every pair: use 'camcal stereo cloud --pose FILE'")

    @property
    def rig(self) -> str | None:
        """The rig file, FILE or FILE#LEFT,RIGHT; None if the cameras are to be calibrated."""
        first = self.inputs[0].rpartition("#")[0] or self.inputs[0]
        return self.inputs[0] if Path(first).suffix.lower() in CAMERA_SUFFIXES else None

    @property
    def pairs(self) -> tuple[str, str]:
        """The left and the right images that become clouds."""
        left, right = self.scene or self.inputs[-2:]
        return left, right
