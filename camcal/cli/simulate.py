"""`camcal simulate`."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from camcal.cli import options as shared
from camcal.cli import show, simulate_stereo

if TYPE_CHECKING:
    from camcal.tasks.simulation.simulate import RawOptions, SimulateOptions, SimulateReport


def simulate(
    context: typer.Context,
    output: shared.Output,
    board: Annotated[
        str | None,
        typer.Argument(
            metavar="BOARD",
            help="A board file, or a short form such as chessboard:9x6:25mm (inner corners), "
            "charuco:9x7:30mm:22mm:DICT_5X5_100 (squares), aprilgrid:6x6:88mm:0.3 (tags) or circles:10x8:25mm:15mm.",
        ),
    ] = None,
    camera_file: Annotated[
        str | None,
        typer.Argument(metavar="CAMERA", help="A camera file, FILE#NAME for one of several; else --model and so on."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(metavar="MODEL", help=f"Lens model: {shared.LENS_MODELS}; by default opencv5."),
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Size of the images; by default 1280x960, of pairs 640x480.")
    ] = None,
    fov: Annotated[
        float | None, typer.Option(metavar="DEG", help="Field of view across the width; by default 70, of pairs 60.")
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
    blur: Annotated[
        float | None,
        typer.Option(metavar="PX", help="Standard deviation of the lens blur; by default 0.7, of pairs 0.4."),
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            metavar="DN",
            help="Standard deviation of the noise, in 1/255 of full scale; by default 2, of pairs 1.",
        ),
    ] = None,
    gradient: Annotated[
        float, typer.Option(metavar="PERCENT", help="How much the light changes from side to side.")
    ] = 20.0,
    vignetting: Annotated[
        float, typer.Option(metavar="PERCENT", help="How much darker the corners of the image are.")
    ] = 10.0,
    gamma: Annotated[
        float | None, typer.Option(help="Images hold brightness to the power 1/gamma; by default 1.")
    ] = None,
    depth: Annotated[int | None, typer.Option(metavar="8|16", help="Bits per pixel; by default 8.")] = None,
    raw: Annotated[
        str | None,
        typer.Option(
            metavar="PATTERN",
            help="Make 16-bit mosaics of a sensor with this pattern: RGGB, GRBG, GBRG, BGGR, or MONO. The options "
            "from --gain to --darks are for them alone.",
        ),
    ] = None,
    gain: Annotated[float | None, typer.Option(metavar="DN/E", help="Counts per electron; by default 0.25.")] = None,
    read_noise: Annotated[
        float | None, typer.Option(metavar="E", help="Standard deviation of a reading, electrons; by default 4.")
    ] = None,
    full_well: Annotated[
        float | None, typer.Option(metavar="E", help="Electrons a pixel holds; by default 15000.")
    ] = None,
    black: Annotated[float | None, typer.Option(metavar="DN", help="Counts without light; by default 64.")] = None,
    bits: Annotated[int | None, typer.Option(metavar="N", help="Bits of the sensor; by default 12.")] = None,
    dark_current: Annotated[
        float | None, typer.Option(metavar="E/S", help="Electrons per second without light; by default 0.")
    ] = None,
    prnu: Annotated[
        float | None, typer.Option(metavar="PERCENT", help="How much the pixels' responses differ; by default 0.")
    ] = None,
    dsnu: Annotated[
        float | None, typer.Option(metavar="E", help="How much the pixels' dark signals differ; by default 0.")
    ] = None,
    light: Annotated[
        str | None, typer.Option(metavar="R,G,B", help="Light on the colours, such as .5,1,.6; by default 1,1,1.")
    ] = None,
    aberration: Annotated[
        float | None,
        typer.Option(
            metavar="PX",
            help="Lateral chromatic aberration: red lies this far outside of green at the corner of the image, and "
            "blue inside.",
        ),
    ] = None,
    flats: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Levels of flat frames to add, two frames each.")
    ] = None,
    darks: Annotated[int | None, typer.Option(metavar="N", min=1, help="Dark frames to add.")] = None,
    stereo: Annotated[
        bool,
        typer.Option(
            "--stereo",
            help="Make rectified pairs of a generated scene, no board. Of them are --pairs to --row-tilt, and "
            "--size, --fov, --blur, --noise, --depth, --seed too.",
        ),
    ] = False,
    pairs: Annotated[int, typer.Option(metavar="N", help="Number of pairs, each of another scene.")] = 1,
    baseline: Annotated[
        float | None, typer.Option(metavar="METRES", help="Distance of the two cameras; by default 0.1.")
    ] = None,
    disparities: Annotated[
        str | None,
        typer.Option(metavar="MIN:MAX", help="Disparities of the scene, pixels; by default 1 to 10 % of the width."),
    ] = None,
    distance: Annotated[
        str | None, typer.Option(metavar="NEAR:FAR", help="Distances of the scene, metres, in place of disparities.")
    ] = None,
    doffs: Annotated[
        float | None, typer.Option(metavar="PX", help="cx of the right camera minus cx of the left; by default 0.")
    ] = None,
    objects: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Boxes, balls, rods and so on; by default 14.")
    ] = None,
    gray: Annotated[bool, typer.Option("--gray", help="Gray images; by default in colour.")] = False,
    right_gain: Annotated[
        float | None, typer.Option(metavar="FACTOR", help="Exposure of the right image; by default 1.")
    ] = None,
    right_offset: Annotated[
        float | None, typer.Option(metavar="DN", help="Added to the right image, 1/255 of full scale; by default 0.")
    ] = None,
    right_gamma: Annotated[
        float | None, typer.Option(metavar="POWER", help="Power taken of the right image first; by default 1.")
    ] = None,
    row_shift: Annotated[
        float | None, typer.Option(metavar="PX", help="How much too low the right image lies; by default 0.")
    ] = None,
    row_tilt: Annotated[
        float | None,
        typer.Option(metavar="PX", help="How much lower it lies at its right border than at its left; by default 0."),
    ] = None,
    seed: Annotated[
        int, typer.Option(metavar="N", min=0, help="Another seed gives other poses, scenes and noise.")
    ] = 0,
    camera: shared.CameraName = None,
    jobs: shared.Jobs = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Photograph a board with a known camera: images, and the truth beside them.

    The folder holds images/, truth.yaml (the camera and the board's shape), board.yaml, poses.csv (camera_T_board) and
    corners.csv (where every corner truly is). The same options and seed give the same bytes. With --raw, flats/ and
    darks/ hold what `camcal sensor` measures a sensor with, a folder for each exposure. With --stereo there is no
    board: the folder holds left/, right/, disparity/ and disparity_right/ (exact), visible/ (white: in both images) and
    rig.yaml.
    """
    from math import radians

    from camcal.errors import InvalidInput
    from camcal.tasks.simulation.simulate import Exposure, Shape, SimulateOptions, document
    from camcal.tasks.simulation.simulate import simulate as run

    simulate_stereo.require_fitting(context, stereo=stereo)
    if stereo:
        simulate_stereo.run(context.params)
        return
    if board is None:
        raise InvalidInput("a board is needed, such as chessboard:9x6:25mm; or --stereo for pairs of a scene")
    sensor = {
        "gain_dn_per_e": gain,
        "read_noise_e": read_noise,
        "full_well_e": full_well,
        "black_dn": black,
        "bits": bits,
        "dark_current_e_s": dark_current,
        "prnu": None if prnu is None else prnu / 100,
        "dsnu_e": dsnu,
    }
    image = {"noise_dn": noise, "gamma": gamma, "depth": depth}
    lens = {"blur_px": blur}
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
        Exposure(gradient=gradient / 100, vignetting=vignetting / 100, **_given(image | lens)),
        seed,
        jobs,
        _raw(raw, _given(image), _given(sensor), light, aberration, flats, darks),
    )
    report = run(options, show.progress(quiet))
    if json:
        show.document("simulate", document(report, options))
    elif not quiet:
        _show(report, options, verbose)


def _given(options: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


def _raw(
    pattern: str | None,
    image: Mapping[str, float],
    sensor: Mapping[str, Any],
    light: str | None,
    aberration: float | None,
    flats: int | None,
    darks: int | None,
) -> "RawOptions | None":
    """Return what is asked of the sensor; raises InvalidInput for options that have no meaning beside the others."""
    from camcal.errors import InvalidInput
    from camcal.tasks.simulation.simulate import RawCamera, RawOptions, Sensor

    if pattern is None:
        if sensor or any(option is not None for option in (light, aberration, flats, darks)):
            raise InvalidInput("--gain, --light, --flats and the other options of a sensor need --raw PATTERN")
        return None
    if image:
        raise InvalidInput("with --raw the sensor says it all: leave out --noise, --gamma and --depth")
    camera = RawCamera(pattern, Sensor(**sensor), _shares(light or "1,1,1"), aberration or 0.0)
    return RawOptions(camera, flats or 0, darks or 0)


def _shares(text: str) -> tuple[float, float, float]:
    from camcal.errors import InvalidInput
    from camcal.parsing import parse_numbers

    try:
        red, green, blue = parse_numbers(text.split(","))
    except ValueError:
        raise InvalidInput(f"--light {text!r}: write three numbers as .5,1,.6 (red, green, blue)") from None
    return red, green, blue


def _coefficients(text: str) -> dict[str, float]:
    """Return the numbers of a text such as k1=-0.2,k2=0.05 by their names."""
    from camcal.errors import InvalidInput
    from camcal.parsing import parse_number

    try:
        pairs = [part.split("=") for part in text.split(",") if part.strip()]
        return {name.strip(): parse_number(value) for name, value in pairs}
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
    if report.frames:
        show.text(f"wrote {len(report.frames)} flat and dark frames")
    show.text(f"next: {_next(options)}")


def _next(options: "SimulateOptions") -> str:
    output, raw = options.output, options.raw
    if raw is None:
        return f"camcal calibrate {output / 'images'} --board {output / 'board.yaml'} -o camera.yaml"
    pattern = f"--pattern {raw.camera.pattern}"
    if raw.flats and raw.darks:
        return f"camcal sensor {output / 'flats'} --dark {output / 'darks'} {pattern} -o sensor.yaml"
    return f"camcal demosaic {output / 'images'} {pattern} -o colour"
