"""The site of docs/ is built without a warning, asks no other host for anything, and can be searched."""

import os
import re
import subprocess
import sys
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from runpy import run_path
from threading import Thread
from types import SimpleNamespace

import pytest
from chromium import running

PROJECT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow

# what a browser loads by itself: not links
_LOADED = re.compile(r"""<(?:script|img|iframe|source|video)\b[^>]*?\bsrc=["']?([^"'\s>]+)|<link\b([^>]*)>""")
_STYLE = re.compile(r"""url\(["']?(https?:[^"')]+)|@import\s+["'](https?:[^"']+)""")


def build(config, folder):
    """Return the exit code of a strict build and what it said; with --quiet mkdocs would count no warning."""
    if find_spec("mkdocs") is None:
        missing = "no mkdocs (pip install '.[docs]')"
        pytest.fail(missing) if os.environ.get("CI") == "true" else pytest.skip(missing)
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", config, "-d", folder]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    ended = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    return ended.returncode, ended.stdout + ended.stderr


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    code, said = build(PROJECT / "mkdocs.yml", folder)
    assert code == 0, said
    return folder


def test_a_link_that_leads_nowhere_ends_the_build(tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("# A\n\n[x](none.md) [y](#none)\n")
    settings = "nav: [index.md]\nhooks: []\nextra_css: []\ndocs_dir: docs\n"
    (tmp_path / "mkdocs.yml").write_text(f"INHERIT: {PROJECT / 'mkdocs.yml'}\n{settings}")
    code, said = build(tmp_path / "mkdocs.yml", tmp_path / "site")
    assert code == 1
    assert "none.md" in said
    assert "#none" in said


def other_hosts(text):
    """Return the addresses on other hosts that a page or a style sheet loads."""
    found = [address for address, _ in _LOADED.findall(text)]
    links = [link for _, link in _LOADED.findall(text) if "canonical" not in link]
    found += [address for link in links for address in re.findall(r"""href=["']?([^"'\s>]+)""", link)]
    found += [address for pair in _STYLE.findall(text) for address in pair]
    return [address for address in found if address.startswith(("http:", "https:", "//"))]


def test_no_page_loads_anything_from_another_host(site):
    planted = '<script src="https://a.b/c.js"></script><link rel="stylesheet" href=//d.e/f.css><a href="https://g.h">'
    assert other_hosts(planted) == ["https://a.b/c.js", "//d.e/f.css"]
    assert other_hosts("@import 'https://i.j/k.css'; body { background: url(http://l.m/n.png) }") == [
        *("https://i.j/k.css", "http://l.m/n.png")
    ]
    texts = {path.relative_to(site).as_posix(): path.read_text() for path in site.rglob("*") if is_text(path)}
    assert len(texts) > 80
    assert {name: found for name, text in texts.items() if (found := other_hosts(text))} == {}


def is_text(path):
    return path.suffix in {".html", ".css"}


def test_every_page_of_the_documentation_is_a_page_of_the_site(site):
    pages = {path.relative_to(PROJECT / "docs").with_suffix(".html") for path in (PROJECT / "docs").rglob("*.md")}
    built = {path.relative_to(site) for path in site.rglob("*.html")}
    assert {path.with_name("index.html") if path.stem == "README" else path for path in pages} <= built
    assert not [path for path in site.rglob("*") if path.suffix in {".py", ".in", ".1"}]


def test_a_link_out_of_the_documentation_is_plain_text():
    hook = run_path(str(PROJECT / "docs" / "site_pages.py"))["on_page_markdown"]
    page = SimpleNamespace(file=SimpleNamespace(src_uri="recipes/a.md"))
    assert hook("[x](../../tests/y.py) [z](../b.md#c) [w](d.md)", page) == "x [z](../b.md#c) [w](d.md)"


def test_a_bar_in_a_table_stands_without_its_backslash(site):
    assert r"`--depth 8\|16`" in (PROJECT / "docs" / "commands" / "simulate.md").read_text()
    assert "<code>--depth 8|16</code>" in (site / "commands" / "simulate.html").read_text()
    assert not [path.name for path in (site / "commands").glob("*.html") if r"\|" in path.read_text()]


class Silent(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.fixture
def address(site):
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Silent, directory=site))
    thread = Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


def show(page, address):
    page.complaints.clear()
    page.loaded = False
    page.call("Page.navigate", url=address)
    while not page.loaded:
        page._listen()
    page.wait_until_drawn()
    return [said for said in page.complaints if "http://127.0.0.1" not in said]


SEARCH = """new Promise((done) => {
  const field = document.querySelector(".md-search__input");
  field.focus();
  field.value = "photon transfer";
  field.dispatchEvent(new Event("keyup"));
  field.dispatchEvent(new Event("input"));
  const wait = setInterval(() => {
    const links = [...document.querySelectorAll(".md-search-result__link")].map((link) => link.href);
    if (links.length) { clearInterval(wait); done(links); }
  }, 50);
})"""


def test_the_site_can_be_read_and_searched_from_disk(site):
    with running((800, 900)) as page:
        page.open(site / "recipes" / "fisheye-rig.html")
        found = page.evaluate(SEARCH)
        assert page.complaints == []
    assert all(link.startswith("file:") for link in found)
    assert any("mathematics.html" in link for link in found)


STILL = """{
  const style = document.createElement("style");
  style.textContent = "* { transition: none !important }";
  document.head.append(style);
}"""


def test_pages_fit_narrow_and_wide_windows_in_a_browser_and_can_be_searched(address):
    with running((400, 900)) as page:
        for name in (
            "index",
            "mathematics",
            "benchmarks",
            "commands/calibrate",
            "formats",
            "tutorial",
            "recipes/fisheye-rig",
        ):
            assert show(page, f"{address}/{name}.html") == [], name
            page.evaluate(STILL)
            for width in (1200, 400):
                page.resize(width, 900)
                page.wait_until_drawn()
                assert page.evaluate("document.documentElement.scrollWidth") <= width, (name, width)
        assert any("mathematics.html" in link for link in page.evaluate(SEARCH))
        assert page.complaints == [said for said in page.complaints if address in said]
