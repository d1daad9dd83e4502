"""The options of commands that work on many items."""

from dataclasses import dataclass
from typing import Annotated

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


DEFAULT_BATCH = BatchOptions()
