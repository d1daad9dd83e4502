"""The exception tree and the exit codes of the command line.

CamcalError             1  never raised itself
├── InvalidInput        2  a wrong argument, or content that breaks a rule
├── FileError           3  a file that cannot be read or written
├── InsufficientData    4  too little or degenerate data
├── NotConverged        5  an iteration that did not settle
├── ItemsFailed         6  some items failed, the rest is written
└── GateFailed          7  a quality gate failed

Every message says what, where, how much and what to do, in one line (several findings: one line each).
"""

import errno
import os
from collections.abc import Sequence

from camcal.messages import Message
from camcal.parsing import in_one_line

EXIT_BUG = 1
EXIT_INTERRUPTED = 130
EXIT_SIGNAL = 128  # and the number of the signal, as shells count

_CV2_NO_MEMORY = -4  # StsNoMem of OpenCV, whose Python exceptions have one type
_DISK_FULL = {errno.ENOSPC: "the disk is full", errno.EDQUOT: "the disk quota is used up"}


class CamcalError(Exception):
    """Base of every error a user can cause.

    where: a file, a key path or an option. failures: what a gate or a verdict found, where one raised it.
    """

    exit_code = EXIT_BUG
    kind = "bug"

    def __init__(self, message: str, *, where: str | None = None, failures: Sequence[Message] = ()) -> None:
        super().__init__(message)
        self.message = message
        self.where = where
        self.failures = tuple(failures)

    def __str__(self) -> str:
        return f"{in_one_line(self.where)}: {self.message}" if self.where else self.message


class Located:
    """A block of work that adds a place to errors without one."""

    def __init__(self, where: object) -> None:
        self.where = str(where)

    def __enter__(self) -> None:
        return

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if isinstance(error, CamcalError) and error.where is None:
            error.where = self.where


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

    @classmethod
    def of(cls, failed: int, items: int, what: str) -> "ItemsFailed":
        """Return the error of some of a number of items; what: these in words, such as images."""
        return cls(f"{failed} of {items} {what} failed, the rest is written")


class GateFailed(CamcalError):
    exit_code = 7
    kind = "gate_failed"

    @classmethod
    def of(cls, failures: "Sequence[Message]", *, where: str | None = None) -> "GateFailed":
        """Return the error of a gate with these failures, a line each; where: as in `CamcalError`."""
        return cls("\n".join(map(str, failures)), where=where, failures=failures)


# When several apply, the first of these is the exit (docs/commands.md).
EXIT_PRECEDENCE = (1, 2, 3, 4, 5, 7, 6, 0)


def translated(error: BaseException) -> CamcalError | None:
    """Return what the machine refused (memory, a file, a path) as an error of the user; None for anything else."""
    if isinstance(error, CamcalError):
        return error
    if isinstance(error, MemoryError) or _is_out_of_memory_in_opencv(error):
        asked = str(getattr(error, "err", error)).rstrip(".")
        return FileError(f"out of memory{': ' if asked else ''}{asked}; use smaller inputs or fewer --jobs")
    if isinstance(error, OSError):
        where = error.filename if isinstance(error.filename, (str, bytes)) else None
        if where is None and error.errno == errno.ENOENT and not _has_working_folder():
            return FileError("the working directory does not exist any more; change to another one")
        return FileError(f"cannot be read or written: {reason(error)}", where=os.fsdecode(where) if where else None)
    return None


def reason(error: OSError) -> str:
    """Return what kept a file from being read or written, in words."""
    return _DISK_FULL.get(error.errno or 0) or error.strerror or str(error)


def _is_out_of_memory_in_opencv(error: BaseException) -> bool:
    return type(error).__module__ == "cv2" and (
        getattr(error, "code", None) == _CV2_NO_MEMORY or "std::bad_alloc" in str(error)
    )


def _has_working_folder() -> bool:
    try:
        os.getcwd()  # noqa: PTH109 - Path.cwd would do the same
    except OSError:
        return False
    return True
