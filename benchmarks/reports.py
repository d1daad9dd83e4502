"""Reports of six simulated calibrations and pictures of their beginnings, for docs/report.md.

    python benchmarks/reports.py reports
    python benchmarks/reports.py reports --pictures docs/pictures

The first prints the verdict of each, the time that the report takes on top of the calibration, and the size of the
file; the second takes the pictures of reports that are there, and needs Chromium.
"""

import argparse
import sys
import time
from pathlib import Path

import cv2

from camcal.errors import InsufficientData
from camcal.formats import detections
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.options import CalibrateOptions

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "report"))
from chromium import running
from report_scenes import SCENES, detections_of

SIZE = (1000, 860)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of the detections and reports")
    parser.add_argument("--pictures", type=Path, help="folder of the pictures")
    options = parser.parse_args()
    if options.pictures:
        draw(options.folder, options.pictures)
        return
    options.folder.mkdir(parents=True, exist_ok=True)
    for name, scene in SCENES.items():
        table = options.folder / f"{name}.csv"
        detections.write(table, detections_of(scene))
        report = options.folder / f"{name}.html"
        alone, words = timed(CalibrateOptions((str(table),)))
        both, _ = timed(CalibrateOptions((str(table),), report=report))
        size = report.stat().st_size / 1e6
        print(f"{name:15} {words:30} report {both - alone:4.1f} s, {size:.1f} MB")


def timed(options: CalibrateOptions) -> tuple[float, str]:
    """Return the processor time of a calibration and its verdict."""
    start = time.process_time()
    try:
        found = calibrate(options)
        words = "trustworthy" if found.trustworthy else f"failed: {', '.join(each.code for each in found.failures)}"
        words += f", {len(found.warnings)} warnings" if found.warnings else ""
    except InsufficientData as error:
        words = f"refused: {', '.join(each.code for each in error.failures)}"
    return time.process_time() - start, words


def draw(folder: Path, pictures: Path) -> None:
    """Write a picture of the beginning of every report."""
    pictures.mkdir(parents=True, exist_ok=True)
    with running(SIZE) as browser:
        for name in SCENES:
            browser.open(folder / f"{name}.html")
            picture = browser.screenshot()[:, :, ::-1]
            cv2.imwrite(str(pictures / f"report-{name}.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
