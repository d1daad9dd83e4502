"""`camcal board`, `simulate` and `demo`: what camcal draws itself."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import Call
from camcal.messages import counted
from camcal.report.table import Column
from camcal.tasks.calibration.drawing_options import SheetOptions
from camcal.tasks.calibration.options import DemoOptions
from camcal.tasks.simulation.options import SimulateOptions

if TYPE_CHECKING:
    from camcal.tasks.calibration.board_sheet import BoardSheet
    from camcal.tasks.calibration.demo import DemoReport
    from camcal.tasks.simulation.simulate import SimulateReport
    from camcal.tasks.simulation.simulate_stereo import StereoReport


PAIR_COLUMNS = (
    Column("image", file=True),
    Column("least", "px"),
    Column("greatest", "px"),
    Column("seen by both", "%"),
)


def board(options: SheetOptions, call: Call) -> None:
    """Draw a calibration board for printing at true scale, and write its board file.

    Print at 100 % (actual size, no scaling) with black ink only, and measure the ruler and some squares on the sheet:
    use the measured size of the squares for calibration.
    """
    from camcal.tasks.calibration.board_sheet import board_sheet, document

    sheet = board_sheet(options, call.progress)
    call.give(lambda: document(sheet), lambda: _show_sheet(sheet))


def _show_sheet(sheet: "BoardSheet") -> None:
    options, (width, height) = sheet.options, sheet.ink.size
    show.text(f"{sheet.board.words}, {width:g} x {height:g} mm, on {sheet.paper.described()}")
    if sheet.pixels is not None:
        show.text("  {} x {} pixels, anti-aliased edges".format(*sheet.pixels))
    show.text("print at 100 % (actual size)" + (", then measure the ruler" if options.ruler else ""))
    show.text(f"next: camcal calibrate IMAGES --board {options.board_file} -o camera.yaml")
    show.wrote(options.output, options.board_file, options.kalibr)


def simulate(options: SimulateOptions, call: Call) -> None:
    """Render images of a board with a known camera, with ground truth.

    The folder holds images/, truth.yaml (the camera and the board's shape), board.yaml, poses.csv (true poses of the
    board) and corners.csv (true corner positions). The same options and seed give the same bytes. With --raw, flats/
    and darks/ hold frames for `camcal sensor`, a folder for each exposure. With --stereo there is no board: the folder
    holds left/, right/, disparity/ and disparity_right/ (exact), visible/ (white: visible in both images) and rig.yaml.
    With the camera file of a rig the board is shown to all its cameras; images/ holds a folder for each of them.
    """
    if options.stereo:
        _simulate_pairs(options, call)
    else:
        from camcal.tasks.simulation.simulate import document
        from camcal.tasks.simulation.simulate import simulate as run

        report = run(options, call.progress)
        call.give(lambda: document(report, options), lambda: _show_photographs(report, options, call.verbose))


def _simulate_pairs(options: SimulateOptions, call: Call) -> None:
    from camcal.tasks.simulation.simulate_stereo import document, simulate_pairs

    report = simulate_pairs(options, call.progress)
    call.give(lambda: document(report, options), lambda: _show_pairs(report, options.output, call.verbose))


def _show_photographs(report: "SimulateReport", options: SimulateOptions, verbose: bool) -> None:
    truth, output = report.truth, options.output
    camera = truth.camera
    count = sum(len(view.ids) for view in report.corners.views)
    size = f"{camera.image_size[0]}x{camera.image_size[1]}"
    taken = f" of {len(report.cameras)} cameras" if report.cameras else f" of {size}"
    show.text(f"{counted(len(report.images), 'image')}{taken}, {count} corners in them")
    if verbose:
        rows: list[list[object]] = [[name, f"{camera.value(name):.6g}"] for name in camera.model.parameter_names]
        show.table(camera.model.name, ["parameter", "value"], rows)
        rows = [[view.image, len(view.ids)] for view in report.corners.views]
        show.table("corners", [Column("image", file=True), Column("corners")], rows)
    frames = f"{len(report.frames)} flat and dark frames to {output}{os.sep}" if report.frames else None
    beside = [output / name for name in ("truth.yaml", "board.yaml", "poses.csv", "corners.csv")]
    images = f"{len(report.images)} images to {output / 'images'}{os.sep}"
    show.wrote(*beside, images if report.cameras else show.several(report.images, "image"), frames)
    show.text(f"next: {_next(options, report.cameras)}")


def _next(options: SimulateOptions, cameras: tuple[str, ...]) -> str:
    output, raw = options.output, options.raw
    if cameras and raw.pattern is None:
        return f"camcal rig {output / 'images'} --board {output / 'board.yaml'} -o rig.yaml"
    if raw.pattern is None:
        return f"camcal calibrate {output / 'images'} --board {output / 'board.yaml'} -o camera.yaml"
    pattern = f"--pattern {raw.pattern}"
    if raw.flats and raw.darks:
        return f"camcal sensor {output / 'flats'} --dark {output / 'darks'} {pattern} -o sensor.yaml"
    return f"camcal demosaic {output / 'images'} {pattern} -o colour"


def _show_pairs(report: "StereoReport", output: Path, verbose: bool) -> None:
    geometry, (width, height) = report.geometry, report.size
    least, greatest = min(pair.least for pair in report.pairs), max(pair.greatest for pair in report.pairs)
    count = len(report.pairs)
    show.text(f"{count} pair{'s' * (count > 1)} of {width}x{height}, disparities {least:.1f} … {greatest:.1f} px")
    show.text(f"fx {geometry.fx:g} px, baseline {geometry.baseline:g} m, doffs {geometry.doffs:g} px")
    if verbose:
        rows = [[pair.left.name, pair.least, pair.greatest, 100 * pair.shared] for pair in report.pairs]
        show.table("pairs", PAIR_COLUMNS, rows)
    show.wrote(report.rig, f"{count} pair{'s' * (count > 1)} with disparities to {output}{os.sep}")
    first = report.pairs[0]
    show.text(f"next: camcal stereo disparity {first.left} {first.right} {report.rig} -o disparity.pfm")


def demo(options: DemoOptions, call: Call) -> None:
    """Calibrate rendered images, undistort one of them, and compare the estimates with ground truth.

    The images are rendered with a known lens and a slightly bent board.
    """
    from camcal.tasks.calibration.demo import demo as run
    from camcal.tasks.calibration.demo import document

    report = run(options, call.progress)
    failures = report.calibrated.assessment.failures
    call.give(lambda: document(report, options), lambda: _show_demo(report, options.output, call.verbose), failures)


def _show_demo(report: "DemoReport", output: Path, verbose: bool) -> None:
    from camcal.report.calibration import summary
    from camcal.report.table import value_and_std

    show.trust(report.calibrated.assessment.failures)
    rows = [
        [row.name, f"{row.truth:.6g}", *value_and_std(row.estimate, row.std), _sigmas(row.sigmas)]
        for row in report.compared
    ]
    show.table("truth beside estimate", ["parameter", "truth", "estimate", "± std", "off by"], rows)
    calibration = report.calibrated.calibration
    for line in (*report.calibrated.lines, *summary(calibration)):
        show.text(line)
    if verbose:
        views = [[view.image, view.kept, view.rms_px] for view in calibration.views]
        show.table("images", [Column("image", file=True), Column("corners"), Column("RMS", "px")], views)
    show.wrote(f"{output}{os.sep}")
    show.text(f"next: read {output / 'README.txt'}, which says what each file is and what to try")


def _sigmas(value: float | None) -> str:
    return "-" if value is None else f"{value:+.1f} σ"
