"""The codes of warnings and failures: one list, every one of it used, and a page that describes them."""

import ast
from collections.abc import Iterator
from pathlib import Path

from generated_pages import WRITE
from messages_page import PAGE, with_codes
from test_layers import modules

import camcal
from camcal.errors import GateFailed
from camcal.messages import CODES, Message, as_data
from camcal.quality.criteria import CRITERIA

PACKAGE = Path(camcal.__file__).parent
LISTED = [code for codes in CODES.values() for code in codes]


def literal_codes(package: Path) -> Iterator[str]:
    """Yield the codes in calls of Message and of functions that pass them on."""
    for _, tree in modules(package):
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call) or not node.args or not isinstance(node.args[0], ast.Constant):
                continue
            if getattr(node.func, "id", "") in {"Message", "_refused"} or getattr(node.func, "attr", "") == "warn":
                yield str(node.args[0].value)


def test_codes_are_listed_once_and_each_is_used(tmp_path):
    (tmp_path / "planted.py").write_text('yield Message("no_such_code", text)')
    assert list(literal_codes(tmp_path)) == ["no_such_code"]
    assert len(set(LISTED)) == len(LISTED)
    assert not set(LISTED) & set(CRITERIA)
    assert set(literal_codes(PACKAGE)) == set(LISTED)


def test_meanings_differ():
    meanings = [meaning for codes in CODES.values() for meaning in codes.values()]
    assert len(set(meanings)) == len(meanings)


def test_the_page_lists_all_codes():
    page = PAGE.read_text(encoding="utf-8")
    assert with_codes(page, CODES, CRITERIA.values()) == page, WRITE


def test_a_message_says_where_and_keeps_its_place():
    message = Message("large_rms", "reprojection RMS 3 px", {"rms_px": 3.0})
    assert str(message) == "reprojection RMS 3 px"
    assert str(message.at("a.yaml")) == str(message.at("a.yaml").at("b.yaml")) == "a.yaml: reprojection RMS 3 px"
    assert as_data([message]) == [
        {"code": "large_rms", "text": "reprojection RMS 3 px", "values": {"rms_px": 3.0}, "where": None}
    ]
    assert len({message, message.at("a.yaml"), message}) == 2


def test_a_gate_carries_its_failures():
    failures = [Message("large_rms", "too large", where="a"), Message("few_images", "too few", where="b")]
    failed = GateFailed.of(failures)
    assert (str(failed), failed.failures) == ("a: too large\nb: too few", tuple(failures))
