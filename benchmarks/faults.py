"""Injected faults: how far they move the lens, how often the verdict fails or warns, and whether it names them.

The lens model is given. A row: the median of the RMS distance over the full frame, in px, by which the calibrated lens
misplaces rays (a rotation taken out); the share of sets that are refused or not to be trusted; the share with a warning
or a failure; the share in which the fault is named; and that among the sets whose lens is wrong by more than 0.5 px.
Of a lens that changes between views the truth is that of the first one.
--clean N: N sets without a fault, of 5 to 100 views, and as many of each kind of errors within views: how often each
code is found.

    python benchmarks/faults.py [--seeds 20] [--views 20] [--faults "zoom step 0.5 %" …] [--clean 300]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
import warnings
from collections import Counter
from dataclasses import dataclass

import numpy as np
from fault_scenes import CLEAN, FAULTS, Case, Fault, case
from projection_error import projection_errors

from camcal.calibrate.intrinsics import Options, calibrate
from camcal.errors import CamcalError
from camcal.quality.assess import assess
from camcal.quality.criteria import CRITERIA

WRONG = 0.5  # px
COUNTS = (5, 7, 10, 15, 20, 30, 50, 100)  # views of clean sets


@dataclass(frozen=True)
class SetVerdict:
    """What became of a set. error: px, inf where it was refused. words: of the refusal."""

    error: float
    trusted: bool
    codes: tuple[str, ...]
    words: str
    seconds: float

    def names(self, fault: Fault) -> bool:
        return any(name in self.codes or (self.words and name in self.words) for name in fault.names)


def verdict(found: Case) -> SetVerdict:
    """Return what the program says of a set."""
    start = time.process_time()
    try:
        calibration = calibrate(found.views, found.board, Options(found.truth.model))
    except CamcalError as error:
        return SetVerdict(np.inf, False, (), str(error), time.process_time() - start)
    seconds = time.process_time() - start
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # lenses that do not hold in the whole frame
        errors = projection_errors(found.truth, calibration.camera)[1]
    assessment = assess(calibration)
    codes = tuple(message.code for message in assessment.messages)
    return SetVerdict(float(np.sqrt(np.nanmean(errors**2))), assessment.trustworthy, codes, "", seconds)


def faults(names: list[str], seeds: int, views: int) -> None:
    """Print the table of faults."""
    print(f"{views} views, {seeds} sets each")
    print("| fault | map error, px | failed | failed or warned | named | lens wrong by > 0.5 px | of these named |")
    print("|---|---|---|---|---|---|---|")
    for name in names:
        fault = FAULTS[name]
        results = [verdict(case(fault, views, seed)) for seed in range(seeds)]
        wrong = [result for result in results if result.error > WRONG]
        named = [result.names(fault) for result in results]
        shares = [
            np.mean([not result.trusted for result in results]),
            np.mean([not result.trusted or bool(result.codes) for result in results]),
            np.mean(named),
        ]
        among = f"{np.mean([result.names(fault) for result in wrong]):.0%}" if wrong else "-"
        error = np.median([result.error for result in results])
        row = " | ".join(f"{share:.0%}" for share in shares)
        print(f"| {name} | {error:.2f} | {row} | {len(wrong)} | {among} |", flush=True)


def clean(count: int, first: int) -> None:
    """Print how often each code is found in sets without a fault, and the share that is trusted."""
    print("| sets | kind | trusted | found |")
    print("|---|---|---|---|")
    for name, kind in CLEAN.items():
        results = [verdict(case(kind, COUNTS[seed % len(COUNTS)], seed)) for seed in range(first, first + count)]
        codes = Counter(code for result in results for code in result.codes)
        refused = sum(bool(result.words) for result in results)
        found = ", ".join(f"{code} {codes[code]}" for code in CRITERIA if codes[code])
        trusted = np.mean([result.trusted for result in results])
        print(f"| {count} | {name} | {trusted:.0%}, {refused} refused | {found} |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--views", type=int, nargs="+", default=[20])
    parser.add_argument("--faults", nargs="*", default=list(FAULTS))
    parser.add_argument("--clean", type=int, default=0)
    parser.add_argument("--first", type=int, default=1000, help="seed of the first clean set")
    options = parser.parse_args()
    for views in options.views if options.faults else []:
        faults(options.faults, options.seeds, views)
    if options.clean:
        clean(options.clean, options.first)


if __name__ == "__main__":
    main()
