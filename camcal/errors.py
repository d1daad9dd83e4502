"""The exception tree and the exit codes of the command line.

CamcalError             1  never raised itself
├── InvalidInput        2  a wrong argument, or content that breaks a rule
├── FileError           3  a file that cannot be read or written
├── InsufficientData    4  too little or degenerate data
├── NotConverged        5  an iteration that did not settle
├── ItemsFailed         6  some items failed, the rest is written
└── GateFailed          7  a quality gate said no

Every message says what, where, how much and what to do, in one line (several findings: one line each).
"""

EXIT_BUG = 1
EXIT_INTERRUPTED = 130


class CamcalError(Exception):
    """Base of every error a user can cause; `where` names a file, a key path or an option."""

    exit_code = EXIT_BUG
    kind = "bug"

    def __init__(self, message: str, *, where: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.where = where

    def __str__(self) -> str:
        return f"{self.where}: {self.message}" if self.where else self.message


class InvalidInput(CamcalError):
    exit_code = 2
    kind = "invalid_input"


class FileError(CamcalError):
    exit_code = 3
    kind = "file"


class InsufficientData(CamcalError):
    exit_code = 4
    kind = "insufficient_data"


class NotConverged(CamcalError):
    exit_code = 5
    kind = "not_converged"


class ItemsFailed(CamcalError):
    exit_code = 6
    kind = "items_failed"


class GateFailed(CamcalError):
    exit_code = 7
    kind = "gate_failed"


# When several apply, the first of these is the exit (docs/commands.md).
EXIT_PRECEDENCE = (1, 2, 3, 4, 5, 7, 6, 0)


def worst_exit(codes: list[int]) -> int:
    """Return the exit code that wins when several apply; 0 for none."""
    return min(codes, key=EXIT_PRECEDENCE.index, default=0)
