"""The files of figures: one for each, and a page with their captions."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camcal import files
from camcal.run.outputs import claim
from camcal.tasks.options import THEMES, FigureOptions

if TYPE_CHECKING:
    from camcal.report.figures.figure import Plot

CAPTIONS = "figures.md"


def write_figures(
    options: FigureOptions, plots: Iterable["Plot"], theme: str = THEMES[0], names: Sequence[str] | None = None
) -> tuple[Path, ...]:
    """Return the files of figures after writing them, and their captions, to the folder of the options.

    names: of the figures, where these are made one after another, as they are written.
    Raises InvalidInput or FileError, before any is written, if one of them must not or cannot be.
    """
    if options.folder is None:
        return ()
    from camcal.report.figures import figure

    if names is None:
        plots = list(plots)
        names = [plot.name for plot in plots]
    paths = [options.folder / f"{name}.{options.kind}" for name in _distinct(names)]
    captions = options.folder / CAPTIONS
    claim((*paths, captions))
    parts = ["# Figures\n"]
    for path, plot in zip(paths, plots, strict=True):
        files.write_bytes(path, figure.encoded(plot, path.suffix, figure.THEMES[theme]))
        parts.append(f"## {plot.title}\n\n![{plot.alt}]({path.name})\n\n{plot.caption}\n")
    files.write_text(captions, "\n".join(parts))
    return tuple(paths)


def _distinct(names: Sequence[str]) -> list[str]:
    """Return names with a number after those that stood before: objects may differ in letters that no file has."""
    return [
        name if name not in names[:index] else f"{name}_{1 + names[:index].count(name)}"
        for index, name in enumerate(names)
    ]


def figure_data(paths: Sequence[Path]) -> dict[str, Any]:
    """Return the files of figures for --json, nothing where none were asked for."""
    return {"figure_files": [path.as_posix() for path in paths]} if paths else {}
