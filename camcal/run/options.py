"""The options of commands that work on many items."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from camcal.errors import CamcalError
from camcal.options import GENERAL, Declared, Option, OptionsRecord, ValueType

LOCAL = "dask://local"

_SHORTEST_S = 1e-3  # a limit below says nothing of the item
_SCHEDULER = re.compile(rf"{LOCAL}|dask(?:\+tls)?://(?:[^\s/@:\[\]]+|\[[0-9A-Fa-f:]+\]):([0-9]{{1,5}})")
_LARGEST_PORT = 65535


def _scheduler(text: str) -> str:
    """Return the URL of a scheduler without a slash at its end; raises ValueError for any other text."""
    url = text.removesuffix("/")
    found = _SCHEDULER.fullmatch(url)
    if found is None or int(found[1] or 0) > _LARGEST_PORT:
        raise ValueError(text)
    return url


@dataclass(frozen=True)
class BatchOptions(OptionsRecord):
    """How the items of a command are worked on; none of it changes a result.

    timeout: seconds for one item, None without limit. scheduler: URL of a Dask scheduler, None for the cores of this
    machine.
    """

    timeout: Annotated[
        float | None,
        Option(
            "Stop an item that takes longer; it counts as failed. By default no limit.",
            metavar="S",
            group=GENERAL,
            least=_SHORTEST_S,
            recorded=False,
        ),
    ] = None
    fail_fast: Annotated[
        bool, Option("Stop at the first item that fails; what is written is kept.", group=GENERAL, recorded=False)
    ] = False
    resume: Annotated[
        bool,
        Option(
            "Skip outputs that are complete and still match input, camera and settings; redo the others.",
            group=GENERAL,
            recorded=False,
        ),
    ] = False
    scheduler: Annotated[
        str | None,
        Option(
            "Work on a Dask cluster: dask://HOST:PORT, dask+tls://HOST:PORT, or dask://local for one of its own.",
            metavar="URL",
            group=GENERAL,
            type=ValueType(_scheduler, str, f"dask://HOST:PORT, dask+tls://HOST:PORT or {LOCAL}"),
            recorded=False,
        ),
    ] = None

    @property
    def keep_going(self) -> "BatchOptions":
        """The same for work on a sample, or once more: a failure there does not end it."""
        return replace(self, fail_fast=False)

    def raise_first(self, errors: Sequence[CamcalError]) -> None:
        """Raise the first error of items where one ends the batch: there is no result of the others alone."""
        if errors and self.fail_fast:
            raise errors[0]


DEFAULT_BATCH = BatchOptions()


def located(each: Declared, given: Any) -> Any:
    """Return the text or texts of an option with paths in place of URLs; see `run.remote`, which only these import."""
    texts = given if isinstance(given, (list, tuple)) else [given]
    if each.option.group == GENERAL or not any(isinstance(text, str) and "://" in text for text in texts):
        return given
    from camcal.run import remote

    found = [remote.given(text) for text in texts]
    return found if isinstance(given, (list, tuple)) else found[0]
