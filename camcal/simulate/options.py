"""Options of the simulated sensor."""

from math import isfinite
from typing import Annotated

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.options import PERCENT, RAW_FRAMES, Option, OptionsRecord

_MOST_BITS = 16


@dataclass(frozen=True)
class Sensor(OptionsRecord):
    """What turns light into counts.

    gain_dn_per_e: counts per electron. read_noise_e: standard deviation, Gaussian, of every reading. full_well_e: what
    a pixel holds; the white level 2**bits - 1 may come first. prnu: standard deviation of the pixels' response, a
    share of it; dsnu_e: of their dark signal. dark_current_e_s: electrons per pixel and second without light.
    """

    gain_dn_per_e: Annotated[
        float, Option("Counts per electron.", metavar="DN/E", group=RAW_FRAMES, names="--gain")
    ] = 0.25
    read_noise_e: Annotated[
        float,
        Option("Read noise (standard deviation), electrons.", metavar="E", group=RAW_FRAMES, names="--read-noise"),
    ] = 4.0
    full_well_e: Annotated[
        float, Option("Full-well capacity, electrons.", metavar="E", group=RAW_FRAMES, names="--full-well")
    ] = 15000.0
    black_dn: Annotated[float, Option("Black level, counts.", metavar="DN", group=RAW_FRAMES, names="--black")] = 64.0
    bits: Annotated[int, Option("Bit depth of the sensor.", metavar="N", group=RAW_FRAMES)] = 12
    dark_current_e_s: Annotated[
        float,
        Option("Dark current, electrons per second.", metavar="E/S", group=RAW_FRAMES, names="--dark-current"),
    ] = 0.0
    prnu: Annotated[
        float,
        Option("Photo response nonuniformity (PRNU).", metavar="PERCENT", group=RAW_FRAMES, type=PERCENT),
    ] = 0.0
    dsnu_e: Annotated[
        float,
        Option("Dark signal nonuniformity (DSNU).", metavar="E", group=RAW_FRAMES, names="--dsnu"),
    ] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.bits <= _MOST_BITS:
            raise InvalidInput(f"{self.bits} bits: use 1 to {_MOST_BITS}")
        positive = {"gain": self.gain_dn_per_e, "full well": self.full_well_e}
        others = (self.read_noise_e, self.dark_current_e_s, self.prnu, self.dsnu_e)
        if not all(isfinite(value) and value > 0 for value in positive.values()):
            raise InvalidInput("the gain and the full well of a sensor must be positive")
        if not all(isfinite(value) and value >= 0 for value in others):
            raise InvalidInput("read noise, dark current, PRNU and DSNU of a sensor are not negative")
        if not 0 <= self.black_dn < self.white_dn:
            raise InvalidInput(f"a black level of {self.black_dn:g}: use 0 to below the white level {self.white_dn}")

    @property
    def white_dn(self) -> int:
        """The largest count."""
        return int(2**self.bits - 1)

    @property
    def saturation_e(self) -> float:
        """Electrons at which the counts end: a full pixel, or the white level if that comes first."""
        return min(self.full_well_e, (self.white_dn - self.black_dn) / self.gain_dn_per_e)


USUAL_SENSOR = Sensor()
