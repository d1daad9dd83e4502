"""The HTML text of a report page, from the templates in assets/page.

Everything is escaped but the style sheet and data blocks, which are checked to hold no markup.
"""

import re
from functools import cache
from importlib.resources import files

from jinja2 import DictLoader, Environment, StrictUndefined
from markupsafe import Markup

from camcal.report.page.record import DataBlock, Page

_ASSETS = files("camcal.report") / "assets" / "page"
_TEMPLATES = ("page.html", "parts.html")
_MARKUP = re.compile("[<>&]")


def rendered(page: Page) -> str:
    """Return the text of the page; the same record gives the same text."""
    return _environment().get_template("page.html").render(page=page, style=_style(), data=_data)


@cache
def _environment() -> Environment:
    sources = {name: _asset(name) for name in _TEMPLATES}
    return Environment(
        loader=DictLoader(sources), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )


@cache
def _style() -> Markup:
    return Markup(_asset("style.css"))  # noqa: S704 - the style sheet of the package


def _data(block: DataBlock) -> Markup:
    """Return the text of a data block; raises ValueError if it could end the element that holds it."""
    if _MARKUP.search(block.text):
        raise ValueError(f"{block.name}: markup in a data block")
    return Markup(block.text)  # noqa: S704 - it has no markup


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")
