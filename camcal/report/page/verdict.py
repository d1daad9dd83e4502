"""The verdict of a page and its messages in words."""

from collections.abc import Iterable, Sequence

from camcal.messages import CODES, Message, counted
from camcal.quality.criteria import CRITERIA, Criterion
from camcal.report.page.record import BAD, FAILURE, GOOD, REFUSED, WARNING, WEAK, PageVerdict, ShownMessage, Table

_MEANINGS = {code: words for group in CODES.values() for code, words in group.items()}
_REMEDY = ": "  # what a message says is: what was found: what to do


def shown_messages(failures: Iterable[Message], warnings: Iterable[Message]) -> tuple[ShownMessage, ...]:
    """Return failures, then warnings, each with what to do and the rule that it is from."""
    every = [(FAILURE, each) for each in failures] + [(WARNING, each) for each in warnings]
    return tuple(_show_message(level, each) for level, each in every)


def _show_message(level: str, message: Message) -> ShownMessage:
    what, remedy = _parts(message.text)
    criterion = CRITERIA.get(message.code)
    rule = _MEANINGS.get(message.code, "") if criterion is None else _rule(criterion, message)
    return ShownMessage(level, message.code, what, remedy, rule, message.where or "")


def _parts(text: str) -> tuple[str, str]:
    """Return what was found and what to do as sentences, "" for what is not said."""
    what, _, remedy = text.rpartition(_REMEDY)
    return (sentence(what), sentence(remedy)) if what else (sentence(text), "")


def shown_reasons(texts: Iterable[str], where: str) -> tuple[ShownMessage, ...]:
    """Return why a file says that a calibration is not to be trusted."""
    return tuple(ShownMessage(FAILURE, "", *_parts(text), where=where) for text in texts)


def sentence(text: str) -> str:
    """Return words as a sentence; names of parameters and files keep their letters."""
    first = text.partition(" ")[0].rstrip(",;")
    begun = text[:1].upper() + text[1:] if first.isalpha() and len(first) > 2 else text
    return f"{begun}." if begun and begun[-1] not in ".!?" else begun


def _rule(criterion: Criterion, message: Message) -> str:
    value = message.values.get("value")
    if not criterion.limit:  # there is nothing to compare
        return criterion.means
    found = f", found {value:.3g}" if isinstance(value, float) else ""
    return f"{criterion.means} (limit {_limit(criterion)}{found})"


def _limit(criterion: Criterion) -> str:
    return f"{criterion.limit:g} {criterion.unit}".strip()


def verdict(failures: Sequence[Message], warnings: Sequence[Message], known: str) -> PageVerdict:
    """Return the verdict of a calibration with these failures and warnings; known: how well it is known, a sentence."""
    if failures:
        why = (
            f"{counted(len(failures), 'check')} failed: what is measured with this calibration may be wrong by more "
            "than its standard deviations say."
        )
        return PageVerdict(BAD, "Do not trust this calibration", why, "The figures below serve to find the cause.")
    if warnings:
        headline = f"Trustworthy, with {counted(len(warnings), 'warning')}"
        return PageVerdict(
            WEAK, headline, f"No check failed. {known}", "The warnings say what is weak, and how to improve it."
        )
    return PageVerdict(GOOD, "Trustworthy", f"All {len(CRITERIA)} checks passed. {known}")


def refusal(message: Message) -> tuple[PageVerdict, ShownMessage]:
    """Return the verdict of detections that no calibration can be made from, and why."""
    why = "No calibration can be made from these detections. Nothing was written but this report."
    return PageVerdict(REFUSED, "No calibration", why), _show_message(FAILURE, message)


def checks_table(messages: Sequence[Message], owner: str) -> Table:
    """Return the table of all criteria and whether they are met; owner: what ends its caption."""
    found = {each.code: each for each in messages}
    rows = [
        [
            criterion.code,
            _result(criterion, criterion.code in found),
            _limit(criterion),
            f"{value:.3g}"
            if criterion.code in found and isinstance(value := found[criterion.code].values.get("value"), float)
            else "",
            criterion.means,
        ]
        for criterion in CRITERIA.values()
    ]
    heads = ("check", "result", "limit", "found", "applies to")
    return Table.of(f"All checks{owner}", heads, rows, folded=True)


def _result(criterion: Criterion, applies: bool) -> str:
    if not applies:
        return "passed"
    return FAILURE if criterion.failure else WARNING
