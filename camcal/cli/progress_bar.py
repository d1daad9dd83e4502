"""The progress bar of a terminal, on stderr."""

import time
from datetime import timedelta
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

_REDRAW_S = 0.1
_BAR = 20  # cells


class ProgressBar:
    """How many items are done, at what rate, and the time left; drawn when items are done, by no thread of its own."""

    def __init__(self) -> None:
        self.bar: Bar | None = None
        self.drawn = 0.0

    def start(self, what: str, total: int | None) -> None:
        from rich import progress as rich
        from rich.console import Console

        self.bar = rich.Progress(
            rich.TextColumn("{task.description}", markup=False),
            rich.BarColumn(_BAR),
            rich.MofNCompleteColumn(),
            rich.TextColumn("{task.fields[pace]}", markup=False),
            console=Console(stderr=True),
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self.bar.add_task(what, total=total, pace="")
        self.bar.start()

    def advance(self, count: int = 1) -> None:
        if self.bar is None:
            return
        self.bar.advance(self.bar.task_ids[0], count)
        if time.monotonic() - self.drawn > _REDRAW_S:
            [task] = self.bar.tasks
            self.bar.update(task.id, pace=pace(task.speed, task.time_remaining))
            self.bar.refresh()
            self.drawn = time.monotonic()

    def finish(self) -> None:
        if self.bar is not None:
            self.bar.stop()
            self.bar = None

    def print_above(self, line: str) -> None:
        """Print a line above the bar, which has to be there."""
        if self.bar is not None:
            self.bar.console.print(line, markup=False, highlight=False, soft_wrap=True)


def pace(speed: float | None, left_s: float | None) -> str:
    """Return how many items a second are done, or how long each takes, and the time left; nothing that is not known."""
    if not speed:
        return ""
    rate = f"{speed:.3g}/s" if speed >= 1 else f"{1 / speed:.3g} s each"
    return rate if left_s is None else f"{rate}, {timedelta(seconds=round(left_s))} left"
