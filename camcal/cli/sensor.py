"""`camcal sensor`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import ImageCall
from camcal.tasks.raw.options import SensorOptions

if TYPE_CHECKING:
    from camcal.tasks.raw.sensor import SensorReport


def sensor(options: SensorOptions, call: ImageCall) -> None:
    """Measure a sensor by photon transfer (EMVA 1288): gain, read noise, full well, dynamic range, nonuniformity.

    Two flat and two dark frames are enough for a first answer; twelve levels from dark to saturated and sixteen dark
    frames for a good one. Frames are sorted by folder, exposure, and brightness.
    """
    from camcal.tasks.raw.sensor import document
    from camcal.tasks.raw.sensor import sensor as run

    report = run(options, call.progress)
    call.give(lambda: document(report, options), lambda: _show(report, options, call.verbose))


def _show(report: "SensorReport", options: SensorOptions, verbose: bool) -> None:
    from camcal.tasks.raw.sensor import rows

    found = report.sensor
    width, height = found.size
    show.text(f"{len(report.flats)} levels of light, {len(report.darks)} of darkness, {width}x{height}")
    show.table("sensor", ["figure", "value", "std", "unit"], rows(found.figures))
    show.text(f"the counts end at the {found.saturation}" if found.saturation != "not reached" else "not saturated")
    if report.pitch is not None:
        show.text(f"pixel pitch {1e6 * report.pitch:.3g} um")
    if verbose:
        for name, part in found.phases.items():
            show.table(name, ["figure", "value", "std", "unit"], rows(part))
    show.text(f"wrote {options.output}" + (f" and {options.plot}" if options.plot else ""))
