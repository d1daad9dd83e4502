"""The tables of lens models and camera formats in docs/formats.md, as models and formats describe themselves.

generated_pages.py writes them.
"""

from collections.abc import Iterable
from pathlib import Path

from camcal.cameras.catalogue import MODELS
from camcal.cameras.lens import CameraModel
from camcal.formats.cameras import FORMATS
from camcal.formats.cameras.record import ROWS, CameraFormat
from camcal.formats.cameras.values import order
from camcal.formats.native_entry import CORE

PAGE = Path(__file__).parents[1] / "docs" / "formats.md"
_LENSES, _FORMATS, _END = "<!-- lens models -->\n", "<!-- camera formats -->\n", "<!-- end -->"


def row(model: CameraModel) -> str:
    """Return a model's row of the table."""
    others = ", ".join(f"`{alias}`" for alias in model.aliases)
    names = [name for name in model.parameter_names if name not in CORE]
    parameters = " ".join([*names[:4], "…", names[-1]] if model.configuration else names)
    return f"| `{model.name}` | {parameters or 'none'} | {model.summary} | {others} |"


def with_models(page: str, models: Iterable[CameraModel]) -> str:
    """Return the page with a row for every model."""
    return _with_table(
        page, _LENSES, ["| model | `distortion` | | other names |", "|---|---|---|---|", *map(row, models)]
    )


ORIGINS = {0.0: "0", 0.5: "½", 1.0: "1"}


def format_row(form: CameraFormat) -> str:
    """Return a camera format's row of the table."""
    suffixes = " ".join(f"`{suffix}`" for suffix in form.suffixes) or "not written"
    lenses = "all" if set(form.models) == set(MODELS) else "exact: " + " ".join(f"`{name}`" for name in form.models)
    cameras = "any number" if form.most_cameras is None else f"up to {form.most_cameras}"
    lens = form.lenses
    counted = "0" if lens is None else "from the middle" if lens.centred else ORIGINS[lens.origin]
    others = (counted, form.poses, lenses, form.note.replace("|", "\\|"))
    return f"| {form.title} | `{form.name}` | {suffixes} | {cameras} | {' | '.join(others)} |"


def order_row(form: CameraFormat) -> str:
    """Return how a format orders the parameters of its lenses."""
    orders = order(form.lenses).items() if form.lenses else ()
    return f"| `{form.name}` | " + "<br>".join(f"{word}: `{keys}`" for word, keys in orders) + " |"


def with_formats(page: str, forms: Iterable[CameraFormat]) -> str:
    """Return the page with a row for every camera format."""
    forms = list(forms)
    titles = ("format", "`--to`", "written as", "cameras", "pixel (0, 0)", "transforms", "lens models", "use")
    lines = [f"| {' | '.join(titles)} |", "|---" * len(titles) + "|", *map(format_row, forms), ""]
    lines += ["| `--to` | parameters of its lenses, in its order |", "|---|---|"]
    lines += [order_row(form) for form in forms if form.lenses is not None]
    lines += ["", "| known, and not read | instead |", "|---|---|"]
    lines += [f"| {row.title}{' (written)' if row.name else ''} | {row.instead} |" for row in ROWS if row.instead]
    return _with_table(page, _FORMATS, lines)


def _with_table(page: str, start: str, lines: Iterable[str]) -> str:
    before, _, rest = page.partition(start)
    return before + start + "\n".join([*lines, ""]) + _END + rest.partition(_END)[2]


def generated() -> dict[Path, str | None]:
    """Return the text of the page."""
    return {PAGE: with_formats(with_models(PAGE.read_text(encoding="utf-8"), MODELS.values()), FORMATS.values())}
