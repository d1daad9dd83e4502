"""`camcal undistort`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import ImageCall
from camcal.messages import counted
from camcal.report.table import Column
from camcal.tasks.calibration.undistort_options import UndistortOptions

if TYPE_CHECKING:
    from camcal.tasks.calibration.undistort import PointsReport, UndistortReport
    from camcal.tasks.calibration.undistort_maps import MapsReport


def undistort(options: UndistortOptions, call: ImageCall) -> None:
    """Undistort images, videos or points, or write the map by which others do, and the camera file of the result.

    Images keep their type, depth and EXIF orientation; frames of a video become images. camera.yaml in the output
    folder describes the undistorted images.
    """
    if options.points is not None:
        from camcal.tasks.calibration.undistort import points_document
        from camcal.tasks.calibration.undistort import undistort_points as run

        report = run(options, call.progress)
        call.give(lambda: points_document(report), lambda: _show_points(report))
    elif options.maps:
        _undistort_maps(options, call)
    else:
        _undistort_images(options, call)


def _undistort_images(options: UndistortOptions, call: ImageCall) -> None:
    from camcal.errors import ItemsFailed
    from camcal.tasks.calibration.undistort import document
    from camcal.tasks.calibration.undistort import undistort as run

    report = run(options, call.progress)
    call.give(lambda: document(report), lambda: _show_undistorted(report, call.verbose))
    show.failed(report.failed)
    if report.failed:
        raise ItemsFailed.of(len(report.failed), len(report.outcomes), "images")


def _undistort_maps(options: UndistortOptions, call: ImageCall) -> None:
    from camcal.tasks.calibration.undistort_maps import maps_document
    from camcal.tasks.calibration.undistort_maps import undistort_maps as run

    report = run(options, call.progress)
    call.give(lambda: maps_document(report), lambda: _show_maps(report))


def _show_maps(report: "MapsReport") -> None:
    show.text(f"{report.usage}; {100 * report.valid:.4g} % of the pixels have a source")
    show.wrote(report.output, report.camera_file)


def _show_points(report: "PointsReport") -> None:
    lost = f", {report.lost} outside the lens model (empty cells)" if report.lost else ""
    show.text(f"{counted(report.count, 'point')}{lost}")
    show.wrote(report.output, report.camera_file)


def _show_undistorted(report: "UndistortReport", verbose: bool) -> None:
    written = [outcome.value.output for outcome in report.outcomes if outcome.value is not None]
    if verbose:
        show.table("undistorted", [Column("image", file=True)], [[str(path)] for path in written], verbose=True)
    if report.aligned:
        show.text(f"{' and '.join(report.aligned)} of colour images undistorted with their own lens models")
    width, height = report.view.image_size
    focal = " ".join(f"{name}={report.view.value(name):.6g}" for name in ("fx", "fy", "cx", "cy"))
    empty = f"; {100 * (1 - report.valid):.1f} % of its pixels without source" if report.valid < 1 else ""
    show.text(f"{report.view.model.name}, {width}x{height}, {focal}{empty}")
    show.reused(report.outcomes, "image")
    if drawn := [each.output for each in show.made(report.outcomes)]:
        show.wrote(report.camera_file, report.mask_file, show.several(drawn, "image"))
