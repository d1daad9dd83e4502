"""`camcal simulate`."""

from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.simulate import SimulateOptions, SimulateReport


def simulate(
    board: Annotated[
        str,
        typer.Argument(
            metavar="BOARD",
            help="A board file, or a short form such as chessboard:9x6:25mm (inner corners) "
            "or charuco:9x7:30mm:22mm:DICT_5X5_100 (squares).",
        ),
    ],
    output: shared.Output,
    camera_file: Annotated[
        str | None,
        typer.Argument(metavar="CAMERA", help="A camera file, FILE#NAME for one of several; else --model and so on."),
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="Lens model: pinhole, opencv4/5/8/12/14, kannala_brandt4; by default opencv5.")
    ] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Size of the images; by default 1280x960.")] = None,
    fov: Annotated[
        float | None, typer.Option(metavar="DEG", help="Field of view across the width; by default 70.")
    ] = None,
    distortion: Annotated[
        str | None,
        typer.Option(metavar="K1=…,…", help="Coefficients, such as k1=-0.2,k2=0.05; by default typical ones."),
    ] = None,
    views: Annotated[int, typer.Option(metavar="N", help="Number of images.")] = 20,
    partial: Annotated[
        bool, typer.Option("--partial", help="Let the border of the image cut the board in every other view.")
    ] = False,
    bow_mm: Annotated[
        tuple[float, float], typer.Option(metavar="X Y", help="Bend of the board: height of the middle along x and y.")
    ] = (0.0, 0.0),
    twist_mm: Annotated[float, typer.Option(metavar="MM", help="Twist of the board: height of its corners.")] = 0.0,
    cubic_mm: Annotated[float, typer.Option(metavar="MM", help="S-shaped bend along x: the factor of x³ - x.")] = 0.0,
    stretch: Annotated[float, typer.Option(metavar="PERCENT", help="How much longer than drawn x is printed.")] = 0.0,
    blur: Annotated[float, typer.Option(metavar="PX", help="Standard deviation of the lens blur.")] = 0.7,
    noise: Annotated[
        float, typer.Option(metavar="DN", help="Standard deviation of the noise, in 1/255 of full scale.")
    ] = 2.0,
    gradient: Annotated[
        float, typer.Option(metavar="PERCENT", help="How much the light changes from side to side.")
    ] = 20.0,
    gamma: Annotated[float, typer.Option(help="Images hold brightness to the power 1/gamma.")] = 1.0,
    depth: Annotated[int, typer.Option(metavar="8|16", help="Bits per pixel.")] = 8,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Another seed gives other poses and noise.")] = 0,
    camera: shared.CameraName = None,
    jobs: shared.Jobs = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Photograph a board with a known camera: images, and the truth beside them.

    The folder holds images/, truth.yaml (the camera and the board's shape), board.yaml, poses.csv (camera_T_board) and
    corners.csv (where every corner truly is). The same options and seed give the same bytes.
    """
    from math import radians

    from camcal.tasks.simulate import Exposure, Shape, SimulateOptions, document
    from camcal.tasks.simulate import simulate as run

    options = SimulateOptions(
        board,
        output,
        camera_file,
        camera,
        model,
        shared.parse_size(size) if size else None,
        None if fov is None else radians(fov),
        None if distortion is None else _coefficients(distortion),
        views,
        partial,
        Shape(bow_mm[0] / 1e3, bow_mm[1] / 1e3, twist_mm / 1e3, cubic_mm / 1e3, stretch / 100),
        Exposure(blur_px=blur, noise_dn=noise, gradient=gradient / 100, gamma=gamma, depth=depth),
        seed,
        jobs,
    )
    report = run(options, show.progress(quiet))
    if json:
        show.document("simulate", document(report, options))
    elif not quiet:
        _show(report, options, verbose)


def _coefficients(text: str) -> dict[str, float]:
    """Return the numbers of a text such as k1=-0.2,k2=0.05 by their names."""
    from camcal.errors import InvalidInput

    try:
        pairs = [part.split("=") for part in text.split(",") if part.strip()]
        return {name.strip(): float(value) for name, value in pairs}
    except ValueError:
        raise InvalidInput(f"--distortion {text!r}: write it as k1=-0.2,k2=0.05") from None


def _show(report: "SimulateReport", options: "SimulateOptions", verbose: bool) -> None:
    truth, output = report.truth, options.output
    camera = truth.camera
    count = sum(len(view.ids) for view in report.corners.views)
    show.text(f"{len(report.images)} images of {camera.image_size[0]}x{camera.image_size[1]}, {count} corners in them")
    if verbose:
        rows = [[name, camera.value(name)] for name in camera.model.parameter_names]
        show.table(camera.model.name, ["parameter", "value"], rows)
        show.table("corners", ["image", "corners"], [[view.image, len(view.ids)] for view in report.corners.views])
    show.text(f"wrote {output / 'images'}, and beside it truth.yaml, board.yaml, poses.csv, corners.csv")
    show.text(f"next: camcal calibrate {output / 'images'} --board {output / 'board.yaml'} -o camera.yaml")
