"""How a command is called, and how it gives its result."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from camcal.cli import show
from camcal.cli.show import plain
from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput, ItemsFailed
from camcal.files import LEDGER, STANDARD
from camcal.images.options import set_max_pixels
from camcal.messages import Message, counted
from camcal.options import GENERAL, Option
from camcal.progress import Progress, Timed, Timing

_MOST_PIXELS = 1e6  # millions; sides are 32-bit numbers


@dataclass(frozen=True)
class Call:
    """How a command is called: what each of them takes beside the options of its task.

    documents: what it gave. timings: of the stages of its work, by their names.
    """

    command: str
    json: Annotated[bool, Option("Print one JSON document on stdout and nothing else.", group=GENERAL)] = False
    quiet: Annotated[bool, Option("Only warnings and errors.", group=GENERAL, names="--quiet -q")] = False
    verbose: Annotated[bool, Option("Show all rows, columns and details.", group=GENERAL, names="--verbose -v")] = False

    documents: list[Callable[[], Mapping[str, Any]]] = field(default_factory=list)
    timings: dict[str, Timing] = field(default_factory=dict)

    def prepare(self) -> None:
        """Set what holds for the whole process."""

    def once(self, options: Any, output: Path | None, work: Callable[[], None], *, resume: bool) -> None:
        """Do the work of a command with one result, unless it is to be resumed and an earlier run has done the same."""
        if not resume or output is None or str(output) == STANDARD:
            work()
            return
        from camcal.run.journal import Finished

        finished = Finished(self.command, options, output)
        known = finished.document()
        if known is None:
            work()
            if self.documents:
                document = plain(self.documents[-1]())
                kept = {name: value for name, value in document.items() if name != "reused"}
                finished.keep(kept | ({"timings": {}} if "timings" in kept else {}))
            return
        failures = [Message(**each) for each in known.get("failures", ())]

        def words() -> None:
            show.text(f"nothing to do: {output} is complete and unchanged")
            if failures:
                show.trust(failures)

        self.give(lambda: {**known, "reused": finished.inputs}, words, failures)

    @property
    def progress(self) -> Progress:
        """What a task reports to."""
        return Timed(show.progress(self.quiet), self.timings)

    def give(
        self,
        document: Callable[[], Mapping[str, Any]],
        words: Callable[[], None],
        failures: Sequence[Message] = (),
    ) -> None:
        """Print a result: as the one JSON document, or in words, or not at all.

        failures: why it is not to be trusted; they go to stderr where there are no words, which say it themselves.
        """
        self.documents.append(document)
        if self.json:
            show.result(self.command, document())
        elif not self.quiet:
            words()
            return
        show.distrust(failures)

    def give_with_reused(
        self, document: Callable[[], Mapping[str, Any]], words: Callable[[], None], failures: Sequence[Message] = ()
    ) -> None:
        """Print a result as `give` does, of how many of its images an earlier run had found the corners, and how long
        the stages of the work took.
        """
        from camcal.run.outputs import Run

        run = LEDGER.get()
        reused = run.found_before if isinstance(run, Run) else 0

        def more() -> None:
            words()
            if reused:
                show.text(f"{counted(reused, 'image')} searched by an earlier run")
            if self.verbose and self.timings:
                rows = [[name, f"{own.wall_s:.2f}", f"{own.cpu_s:.2f}"] for name, own in self.timings.items()]
                show.table("time of this process, s", ["stage", "wall clock", "processor"], rows)

        timings = {name: vars(timing) for name, timing in self.timings.items()}
        self.give(lambda: {**document(), "reused": reused, "timings": timings}, more, failures)

    def require_all(self, failed: Sequence[str], what: str, output: Path | None) -> None:
        """Raise ItemsFailed if images failed, with what of them, and how a run that has left its journal goes on."""
        if failed:
            from camcal.run.journal import resume_hint

            raise ItemsFailed(f"{counted(len(failed), 'image')} {what}{resume_hint(output)}")


@dataclass(frozen=True)
class ImageCall(Call):
    """How a command is called that decodes images."""

    max_pixels: Annotated[
        float | None,
        Option(
            "Refuse images of more megapixels before decoding; by default 300.",
            metavar="MILLIONS",
            group=GENERAL,
        ),
    ] = None

    def prepare(self) -> None:
        """Set how many pixels an image may have; every reader asks for it, and worker processes inherit it."""
        if self.max_pixels is None:
            return
        if not 0 < self.max_pixels <= _MOST_PIXELS:
            raise InvalidInput(f"--max-pixels {self.max_pixels:g}: more than 0 and at most {_MOST_PIXELS:g} million")
        set_max_pixels(round(self.max_pixels * 1e6))


class _Texts:
    """What typer reads the values of a parameter with: texts as they were typed, which options read themselves.

    usual: typer's own reader, of all other values. It loads pydantic, which takes longer than many commands.
    """

    def __init__(self, usual: Callable[[], Any]) -> None:
        self.usual = usual

    def __call__(self) -> "_Texts":
        return self

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return a value as the type that the parameter has."""
        kind = param.type_descriptor.annotation
        if value is None and kind in (str, bool, Path):
            return None
        if isinstance(value, str) and kind in (str, Path):
            return kind(value)
        if kind == list[str] and isinstance(value, (list, tuple)) and all(isinstance(each, str) for each in value):
            return list(value)
        return self.usual().coerce(value, param=param, ctx=ctx)


class TextParameters:
    """A command or group of typer's whose parameters keep the texts of a command line as they are."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return all parameters, --help among them."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for parameter in parameters:
            if not isinstance(parameter.get_runtime_param, _Texts):
                parameter.get_runtime_param = _Texts(parameter.get_runtime_param)
        return parameters

    def get_help_option_names(self, ctx: Any) -> list[str]:
        """Return the names of --help in the order of all other options; typer gives them in none."""
        return sorted(super().get_help_option_names(ctx), key=len)  # type: ignore[misc]
