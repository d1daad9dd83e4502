"""What tests of commands share: running one."""

from collections.abc import Callable

import pytest
from typer.main import get_command

from camcal.cli.main import app

COMMAND = get_command(app)  # once: building it takes longer than most commands


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """A function that runs a command line and gives its exit code, stdout and stderr."""

    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as leaving:
            COMMAND([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return int(leaving.value.code or 0), printed.out, printed.err

    return call
