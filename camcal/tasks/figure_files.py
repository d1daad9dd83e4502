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

    paths = [options.folder / f"{name}.{options.kind}" for name in _distinct([plot.name for plot in plots])]
    captions = options.folder / CAPTIONS
    claim((*paths, captions))
    for path, plot in zip(paths, plots, strict=True):
        files.write_bytes(path, figure.encoded(plot, path.suffix, figure.THEMES[theme]))
    files.write_text(captions, captions_page(plots, paths))
    return tuple(paths)


def _distinct(names: Sequence[str]) -> list[str]:
    """Return names with a number after those that stood before: objects may differ in letters that no file has."""
    return [
        name if name not in names[:index] else f"{name}_{1 + names[:index].count(name)}"
        for index, name in enumerate(names)
    ]


def captions_page(plots: Sequence["Plot"], paths: Sequence[Path]) -> str:
    """Return a page in Markdown that shows figures beside it with their captions."""
    shown = zip(plots, paths, strict=True)
    parts = [f"## {plot.title}\n\n![{plot.alt}]({path.name})\n\n{plot.caption}\n" for plot, path in shown]
    return "\n".join(["# Figures\n", *parts])


def figure_data(paths: Sequence[Path]) -> dict[str, Any]:
    """Return the files of figures for --json, nothing where none were asked for."""
    return {"figure_files": [path.as_posix() for path in paths]} if paths else {}
