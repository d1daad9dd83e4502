"""`camcal demo`: calibration of rendered images, with estimates beside ground truth."""

from typing import Any

from camcal import files
from camcal.calibrate.intrinsics import Calibration
from camcal.dataclass import dataclass
from camcal.progress import SILENT, Progress
from camcal.run.outputs import claim, writes
from camcal.simulate.scene import Truth
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.camera_result import CalibrateReport
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.options import CalibrateOptions, DemoOptions
from camcal.tasks.calibration.undistort import UndistortReport, undistort
from camcal.tasks.simulation.options import BoardShape, SimulateOptions
from camcal.tasks.simulation.simulate import BOARD, IMAGES, SimulateReport, simulate

PRINTED_BOARD = "chessboard:10x7:30mm"
BEND = BoardShape(bow=(0.8e-3, 0.4e-3), twist=0.2e-3)
SIZE = (1024, 768)
CAMERA = "camera.yaml"
DETECTIONS = "detections.csv"
UNDISTORTED = "undistorted"
README = "README.txt"

_README = """\
What `camcal demo` left here

images/           {count} photographs, rendered: a chessboard of 10 x 7 inner corners, squares of 30 mm, slightly bent,
                  by a camera with known parameters
board.yaml        the board; commands take it as --board
detections.csv    the detected corners; a calibration can start from them
camera.yaml       the result: the camera with standard deviations, and the board's shape
undistorted/      one undistorted image, and its camera file
truth.yaml        ground truth: the camera, and the bend of the board
poses.csv         ground truth: the pose of the board in every image, camera_T_object
corners.csv       ground truth: the corners in every image

What to try next, in this folder

camcal inspect camera.yaml                                          the estimated camera
camcal inspect truth.yaml                                           the true camera
camcal calibrate images --board board.yaml -o again.yaml            the calibration again, from the images
camcal calibrate detections.csv -o again.yaml                       the same from the corners, without the images
camcal calibrate detections.csv --flat-board -o flat.yaml           without the bend: a less accurate result
camcal undistort camera.yaml images -o straight --alpha 1           all images, with every pixel of them
camcal simulate charuco:9x7:30mm:22mm:DICT_5X5_100 -o other         other boards, lenses, light: see --help

With photographs of your own, of a board of your own, this is all:

camcal calibrate photos --board chessboard:9x6:25mm -o camera.yaml
"""


@dataclass(frozen=True)
class Compared:
    """A number as it is, as it was estimated, and the standard deviation that was claimed (None: it was held)."""

    name: str
    truth: float
    estimate: float
    std: float | None

    @property
    def sigmas(self) -> float | None:
        """The error in standard deviations."""
        return (self.estimate - self.truth) / self.std if self.std else None


@dataclass(frozen=True, eq=False)
class DemoReport:
    """What the three steps say, and truth beside estimate."""

    simulated: SimulateReport
    calibrated: CalibrateReport
    undistorted: UndistortReport
    compared: tuple[Compared, ...]


@writes
def demo(options: DemoOptions, progress: Progress = SILENT) -> DemoReport:
    """Return truth beside estimate after leaving images, corners, cameras and an explanation in options.output.

    Raises InvalidInput if the folder holds something else, FileError if it cannot be written.
    """
    folder = options.output
    claim(folder / name for name in (CAMERA, DETECTIONS, README))
    simulated = simulate(_scene(options), progress)
    calibrated = calibrate(
        CalibrateOptions(
            (str(folder / IMAGES),),
            folder / CAMERA,
            str(folder / BOARD),
            save_detections=folder / DETECTIONS,
            jobs=options.jobs,
        ),
        progress,
    )
    undistorted = undistort(
        UndistortOptions(str(folder / CAMERA), folder / UNDISTORTED, (str(simulated.images[0]),), jobs=options.jobs),
        progress,
    )
    files.write_text(folder / README, _README.format(count=len(simulated.images)))
    return DemoReport(simulated, calibrated, undistorted, compare(simulated.truth, calibrated.calibration))


def _scene(options: DemoOptions) -> SimulateOptions:
    return SimulateOptions(
        options.output,
        PRINTED_BOARD,
        size=SIZE,
        views=options.views,
        shape=BEND,
        seed=options.seed,
        jobs=options.jobs,
    )


def compare(truth: Truth, calibration: Calibration) -> tuple[Compared, ...]:
    """Return the parameters of the lens and the bend of the board, in millimetres, as they are and as estimated."""
    true, estimated, surface = truth.camera, calibration.camera, calibration.surface
    lens = tuple(
        Compared(name, true.value(name), estimated.value(name), estimated.std(name))
        for name in estimated.model.parameter_names
        if name in true.model.parameter_names
    )
    bend = 1e3 * truth.shape.deflection(truth.board)
    return (*lens, Compared("bend of the board, mm", bend, 1e3 * surface.deflection, 1e3 * surface.deflection_std))


def document(report: DemoReport, options: DemoOptions) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    calibration = report.calibrated.calibration
    return {
        "output": options.output.as_posix(),
        "images": len(report.simulated.images),
        "views_used": len(calibration.used),
        "rms_px": calibration.rms_px,
        "sigma_px": calibration.sigma_px,
        "trustworthy": report.calibrated.assessment.trustworthy,
        "compared": [
            {"name": row.name, "truth": row.truth, "estimate": row.estimate, "std": row.std, "sigmas": row.sigmas}
            for row in report.compared
        ],
    }
