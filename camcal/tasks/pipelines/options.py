"""The options of `camcal run`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from camcal.errors import InvalidInput
from camcal.files import STANDARD
from camcal.options import INPUT, OUTPUT, Argument, Option, OptionsRecord, Without, Written
from camcal.run.options import BatchOptions
from camcal.tasks.options import Jobs, Overwrite

STEPS = "Steps"


@dataclass(frozen=True)
class PipelineOptions(OptionsRecord):
    """A pipeline file, values for its variables, which of its steps are run, and where its state is kept.

    only: names of steps, none for all; first: the step to begin with. state: None for a file beside the pipeline.
    """

    pipeline: Annotated[
        Path, Argument("Pipeline: a YAML file of steps, each a command with its options.", metavar="PIPELINE")
    ]
    variables: Annotated[
        tuple[str, ...],
        Option("Value of a variable of the pipeline; repeatable.", metavar="NAME=VALUE", group=INPUT, names="--set"),
    ] = ()
    only: Annotated[
        tuple[str, ...],
        Option(
            "Run this step only, NAME or NAME[ITEM]; repeatable. Its inputs must be there.",
            metavar="STEP",
            group=STEPS,
        ),
    ] = ()
    first: Annotated[
        str | None,
        Option("Run this step and the steps that need its results.", metavar="STEP", group=STEPS, names="--from"),
    ] = None
    force: Annotated[bool, Option("Run steps that are up to date too.", group=STEPS)] = False
    dry_run: Annotated[
        bool, Option("List the steps that would run and why, and do nothing else.", group=STEPS, names="--dry-run -n")
    ] = False
    state: Annotated[
        Path | None,
        Option(
            "File with what the steps were made from; by default .NAME.state.json beside the pipeline.",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=Written((".json",)),
        ),
    ] = None
    overwrite: Overwrite = False
    jobs: Jobs = None
    batch: Annotated[BatchOptions, Without(("timeout", "resume"))] = field(default_factory=BatchOptions)

    def __post_init__(self) -> None:
        super().__post_init__()
        if str(self.pipeline) == STANDARD:
            raise InvalidInput(
                "a pipeline is read from a file: its paths are relative to the folder of that", where=STANDARD
            )
        if self.only and self.first is not None:
            raise InvalidInput("--only and --from both choose steps; give one of them")
        for text in self.variables:
            if not text.partition("=")[0] or "=" not in text:
                raise InvalidInput(f"--set {text}: write it as NAME=VALUE")

    @property
    def state_file(self) -> Path:
        """Where the state is kept."""
        return self.state or self.pipeline.with_name(f".{self.pipeline.stem}.state.json")
