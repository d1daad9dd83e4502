"""The navigation of the site, and what its pages say otherwise (a hook of mkdocs).

In the navigation `folder/*` stands for the other pages of a folder, `*` for all others; a page that does not exist is
left out. Three things are written for the repository's own view and read otherwise by mkdocs: what stands behind the
language of a fence, for tests, is removed; a bar in code within a table needs no backslash; a link to a file outside
docs/, such as a script, becomes plain text.
"""

import re
from fnmatch import fnmatch
from typing import Any

_CODE = re.compile(r"`[^`]+`")


def on_files(files: Any, config: Any) -> None:
    """Fill the navigation with the pages that there are."""
    pages = sorted(file.src_uri for file in files.documentation_pages())
    named = set(_leaves(config["nav"]))
    groups = [pattern for pattern in named if "*" in pattern and pattern != "*"]
    others = [page for page in pages if page not in named and not any(fnmatch(page, one) for one in groups)]
    config["nav"] = _filled(config["nav"], [page for page in pages if page not in named], others, set(pages))


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Return a page as mkdocs reads it."""
    above = "../" * (page.file.src_uri.count("/") + 1)
    markdown = re.sub(rf"\[([^\]]+)\]\({re.escape(above)}[^)]*\)", r"\1", markdown)
    plain = re.sub(r"^```(\w+) \w+$", r"```\1", markdown, flags=re.MULTILINE)
    return re.sub(r"^\|.*$", lambda row: _CODE.sub(_with_bars, row[0]), plain, flags=re.MULTILINE)


def _with_bars(code: re.Match[str]) -> str:
    return code[0].replace(r"\|", "|")


def _leaves(entry: Any) -> list[str]:
    """Return the pages and patterns of a navigation."""
    if isinstance(entry, str):
        return [entry]
    parts = entry.values() if isinstance(entry, dict) else entry
    return [leaf for part in parts for leaf in _leaves(part)]


def _filled(entries: list[Any], free: list[str], others: list[str], known: set[str]) -> list[Any]:
    """Return entries with patterns replaced by pages, and without pages that are not there."""
    filled: list[Any] = []
    for entry in entries:
        if isinstance(entry, dict):
            filled += [{title: _filled(below, free, others, known)} for title, below in entry.items()]
        elif "*" in entry:
            filled += others if entry == "*" else [page for page in free if fnmatch(page, entry)]
        elif entry in known:
            filled.append(entry)
    return filled
