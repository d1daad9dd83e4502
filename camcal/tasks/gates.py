"""What a camera file has to state of a camera: gates that need no images."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

from camcal.dataclass import dataclass
from camcal.messages import Message
from camcal.options import CHECKS, PERCENT, Option, OptionsRecord

if TYPE_CHECKING:
    from camcal.formats.camera_file import CameraEntry

TRUSTWORTHY = "trustworthy"
_NOTHING = "the file states no {}: calibrate with camcal"


def trust_option(text: str) -> Option:
    """Return an option that asks for a calibration to be trustworthy."""
    return Option(text, metavar=TRUSTWORTHY, group=CHECKS, choices=(TRUSTWORTHY,), recorded=False)


@dataclass(frozen=True)
class CameraGates(OptionsRecord):
    """What cameras of a file must be: their verdict, their largest projection uncertainty (px), the least share of the
    image in which their verdict holds; None for no gate.
    """

    require: Annotated[
        str | None,
        trust_option("Exit with 7 if a camera's verdict in the file is not that it is trustworthy."),
    ] = None
    max_uncertainty: Annotated[
        float | None,
        Option(
            "Exit with 7 if the stated projection uncertainty (RMS over the area with corners) of a camera is larger.",
            metavar="PX",
            group=CHECKS,
            least=0,
            recorded=False,
        ),
    ] = None
    min_coverage: Annotated[
        float | None,
        Option(
            "Exit with 7 if the verdict of a camera holds in a smaller share of the image.",
            metavar="PERCENT",
            group=CHECKS,
            type=PERCENT,
            least=0,
            most=1,
            recorded=False,
        ),
    ] = None

    @property
    def given(self) -> bool:
        """Whether there is any."""
        return self != NO_GATES

    def failures(self, camera: str, entry: "CameraEntry") -> Iterator[Message]:
        """Yield a failure for every gate that a camera of this name does not pass; what is not stated does not pass."""
        _, reached, share = stated(entry).values()
        if self.require is not None and entry.verdict is None:
            yield Message("not_stated", _NOTHING.format("verdict"), {}, camera)
        elif self.require is not None and entry.verdict is not None and not entry.verdict.trustworthy:
            reasons = "; ".join(entry.verdict.reasons) or "the file gives no reason"
            yield Message("untrustworthy", f"not trustworthy: {reasons}", {}, camera)
        limit = self.max_uncertainty
        if limit is not None and (reached is None or reached > limit):
            if reached is None:
                yield Message("not_stated", _NOTHING.format("projection uncertainty"), {}, camera)
            else:
                text = f"projection uncertainty {reached:.3g} px (limit {limit:g} px)"
                yield Message("projection_uncertainty", text, {"uncertainty_px": reached, "limit_px": limit}, camera)
        least = self.min_coverage
        if least is not None and (share is None or share < least):
            if share is None:
                yield Message("not_stated", _NOTHING.format("region of its verdict"), {}, camera)
            else:
                text = f"the verdict holds in {100 * share:.0f} % of the image (limit {100 * least:g} %)"
                yield Message("small_region", text, {"share": share, "limit": least}, camera)


NO_GATES = CameraGates()


def stated(entry: "CameraEntry") -> dict[str, float | None]:
    """Return what a file says of a camera: trustworthy, projection uncertainty_px at infinity (RMS over the area with
    corners, or else the image), coverage, the share of the image in which the verdict holds; None for what it does not.
    """
    far = next((item.figures for item in entry.projection if item.range_m is None), {})
    region = entry.verdict.region if entry.verdict is not None else None
    return {
        "trustworthy": None if entry.verdict is None else entry.verdict.trustworthy,
        "uncertainty_px": far.get("inside_rms_px", far.get("rms_px")),
        "coverage": None if region is None else region.share,
    }
