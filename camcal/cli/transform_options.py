"""What the commands of `camcal transform` share: their options, and numbers below zero as arguments."""

import re
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

_NEGATIVE = re.compile(r"-[0-9.]")


class NumbersCommand(TyperCommand):
    """A command whose arguments may be numbers below zero, which are no options."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse a command line with a blank before every number below zero, which a number does not mind."""
        return super().parse_args(ctx, [f" {text}" if _NEGATIVE.match(text) else text for text in args])


Poses = Annotated[
    list[str],
    typer.Argument(
        metavar="POSE…",
        help="Numbers in quotes, Rz(90deg), a file of numbers, FILE (all transforms of a frames, camera or pose file) "
        "or FILE#NAME; NAME=… before numbers or a file says what they take where, as base_T_cam=pose.txt.",
    ),
]
Given = Annotated[
    str | None,
    typer.Option(
        "--form",
        metavar="FORM",
        help="What the numbers given are: matrix, quat:wxyz, quat:xyzw, rvec[:deg], euler:ZYX:deg (capitals intrinsic, "
        "xyz extrinsic), dual-quat, tum, kitti, colmap, ros; by default as their count says.",
    ),
]
As = Annotated[
    str | None,
    typer.Option("--as", metavar="FORM", help="Give bare numbers in this form, one of those of --form."),
]
OutputFile = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help="Where to write: .yaml or .json with covariances; .txt.",
    ),
]
