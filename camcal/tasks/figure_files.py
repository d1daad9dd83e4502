"""The files of figures: one for each, and a page with their captions."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camcal import files
from camcal.run.outputs import claim
from camcal.tasks.options import THEMES, FigureOptions

if TYPE_CHECKING:
    from camcal.report.figures.figure import Plot

CAPTIONS = "figures.md"


def write_figures(options: FigureOptions, plots: Sequence["Plot"], theme: str = THEMES[0]) -> tuple[Path, ...]:
    """Return the files of figures after writing them, and their captions, to the folder of the options.

    Raises InvalidInput or FileError, before any is written, if one of them must not or cannot be.
    """
    if options.folder is None:
        return ()
    from camcal.report.figures import figure

    paths = [options.folder / f"{plot.name}.{options.kind}" for plot in plots]
    captions = options.folder / CAPTIONS
    claim((*paths, captions))
    for path, plot in zip(paths, plots, strict=True):
        files.write_bytes(path, figure.encoded(plot, path.suffix, figure.THEMES[theme]))
    files.write_text(captions, captions_page(plots, options.kind))
    return tuple(paths)


def captions_page(plots: Sequence["Plot"], kind: str) -> str:
    """Return a page in Markdown that shows figures of a type with their captions."""
    parts = [f"## {plot.title}\n\n![{plot.alt}]({plot.name}.{kind})\n\n{plot.caption}\n" for plot in plots]
    return "\n".join(["# Figures\n", *parts])


def figure_data(paths: Sequence[Path]) -> dict[str, Any]:
    """Return the files of figures for --json, nothing where none were asked for."""
    return {"figures": [path.as_posix() for path in paths]} if paths else {}
