"""`camcal doctor`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import Call
from camcal.report.table import Column

if TYPE_CHECKING:
    from camcal.tasks.doctor import Examination

OPTIONAL_COLUMNS = ("extra", "name", "installed", "needed", Column("for", wraps=True))


def doctor(call: Call) -> None:
    """Show versions of camcal and its packages, and check that they work together.

    The exit code is 7 if a check fails.
    """
    from camcal.errors import GateFailed
    from camcal.tasks.doctor import document, examine

    found = examine()
    call.give(lambda: document(found), lambda: _show(found, call.verbose))
    if found.failures:
        raise GateFailed.of(found.failures)


def _show(found: "Examination", verbose: bool) -> None:
    if not found.failures:
        show.verdict("all checks passed", good=True)
    show.text(f"camcal {found.camcal}, Python {found.python}, {found.cores} cores to use")
    show.text(found.system)
    rows = [[package.name, package.version or "-", package.wanted] for package in found.packages]
    show.table("Packages", ["name", "installed", "needed"], rows)
    optional = [[each.extra, each.name, each.version or "-", each.wanted, each.purpose] for each in found.optional]
    show.table("Optional packages: pip install 'camcal[EXTRA]'", OPTIONAL_COLUMNS, optional, verbose=verbose)
    if verbose:
        for line in (*found.opencv_wheels, *(f"{name}={value}" for name, value in found.environment.items())):
            show.text(line)
