"""`camcal doctor`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import Call

if TYPE_CHECKING:
    from camcal.tasks.doctor import Examination


def doctor(call: Call) -> None:
    """Say what is installed and what is in the way.

    The exit code is 7 if anything is.
    """
    from camcal.errors import GateFailed
    from camcal.tasks.doctor import document, examine

    found = examine()
    call.give(lambda: document(found), lambda: _show(found, call.verbose))
    if found.problems:
        raise GateFailed("\n".join(found.problems))


def _show(found: "Examination", verbose: bool) -> None:
    show.text(f"camcal {found.camcal}, Python {found.python}, {found.cores} cores to use")
    show.text(found.system)
    rows = [[package.name, package.version or "-", package.wanted] for package in found.packages]
    show.table("Packages", ["name", "installed", "needed"], rows)
    if verbose:
        for line in (*found.opencv_wheels, *(f"{name}={value}" for name, value in found.environment.items())):
            show.text(line)
    if not found.problems:
        show.verdict("Nothing is in the way.", good=True)
