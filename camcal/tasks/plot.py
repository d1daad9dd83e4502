"""`camcal plot`: figures of the files that other commands wrote."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camcal import files
from camcal.errors import InvalidInput
from camcal.parsing import did_you_mean
from camcal.progress import SILENT, Progress
from camcal.report.figures.figure import THEMES, Plot, encoded, of_part
from camcal.run.outputs import writes
from camcal.run.paths import find_files
from camcal.tasks.figure_files import write_figures
from camcal.tasks.options import FIGURES, FigureOptions, PlotOptions
from camcal.tasks.plot_kinds import Drawable, drawable


@dataclass(frozen=True, eq=False)
class PlotReport:
    """What was drawn, by the files it is of, and the files that were written."""

    drawn: tuple[Drawable, ...]
    figures: tuple[Path, ...]


@writes
def plot(options: PlotOptions, progress: Progress = SILENT) -> PlotReport:
    """Return what was drawn, after writing it to options.output.

    Raises FileError for a file that is not there or of no kind that can be drawn, InvalidInput for a figure that there
    is none of, or where one file is named for several; nothing is written then.
    """
    found = tuple(drawable(path, options.reference, progress) for path in find_files(options.inputs))
    plots = _chosen(_named(found), options.figures)
    output = options.output
    if output is None:
        return PlotReport(found, ())
    if output.suffix.lower() in FIGURES.known and not output.is_dir():
        if len(plots) > 1:
            names = ", ".join(each.name for each in plots)
            raise InvalidInput(
                f"takes one figure, there are {len(plots)}: choose one with --figure ({names}), or name a folder",
                where=str(output),
            )
        files.write_bytes(output, encoded(plots[0], output.suffix, THEMES[options.theme]))
        return PlotReport(found, (output,))
    written = write_figures(FigureOptions(output, options.kind), plots, options.theme)
    return PlotReport(found, written)


def _named(found: Sequence[Drawable]) -> list[Plot]:
    """Return all figures; those of several files have the names of their files before their own."""
    if len(found) == 1:
        return list(found[0].plots)
    stems = [each.path.stem for each in found]
    names = [stem if stems.count(stem) == 1 else f"{number}_{stem}" for number, stem in enumerate(stems, 1)]
    return [own for each, name in zip(found, names, strict=True) for own in of_part(each.plots, name)]


def _chosen(plots: Sequence[Plot], wanted: Sequence[str]) -> list[Plot]:
    """Return the figures that are wanted, all where none are named."""
    names = [each.name for each in plots]
    for name in wanted:
        if name not in names:
            raise InvalidInput(
                f"--figure {name}: no such figure{did_you_mean(name, names)}; there are {', '.join(names)}"
            )
    return [each for each in plots if not wanted or each.name in wanted]


def document(report: PlotReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {
        "inputs": [{"file": each.path.as_posix(), "kind": each.kind} for each in report.drawn],
        "figure_files": [path.as_posix() for path in report.figures],
        "captions": {own.name: own.caption for each in report.drawn for own in each.plots},
    }
