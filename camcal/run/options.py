"""The options of commands that work on many items."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

from camcal.errors import CamcalError
from camcal.options import GENERAL, Option, OptionsRecord

_SHORTEST_S = 1e-3  # a limit below says nothing of the item


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
            "Dask scheduler that the items are sent to: dask://HOST:PORT, or dask://local for one of its own.",
            metavar="URL",
            group=GENERAL,
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
