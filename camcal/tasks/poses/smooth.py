"""`camcal smooth`: poses or numbers over time, smoothed, with what is known of them and of their noise."""

from dataclasses import asdict
from typing import Any

from camcal.errors import InvalidInput
from camcal.formats import trajectories
from camcal.progress import SILENT, Progress
from camcal.report import figures
from camcal.run.paths import refuse_overwriting
from camcal.tasks.poses.smooth_options import SmoothOptions
from camcal.tasks.poses.smooth_table import smooth_table
from camcal.tasks.poses.smooth_trajectory import evaluation, smooth_trajectory
from camcal.tasks.poses.smoothing import Smoothing

_TABLE_SUFFIX = ".csv"


def smooth(options: SmoothOptions, progress: Progress = SILENT) -> Smoothing:
    """Return what came of smoothing, everything asked for written.

    Raises InvalidInput and FileError for what cannot be read, InsufficientData naming what is not observed.
    """
    inputs = [path for path in (options.source, options.controls, options.reference) if path is not None]
    refuse_overwriting([path for path in (options.output, options.plot) if path is not None], inputs)
    if options.plot is not None:
        figures.require_suffix(options.plot)
    return smooth_table(options) if _is_table(options) else smooth_trajectory(options, progress)


def document(found: Smoothing) -> dict[str, Any]:
    """Return what came of smoothing as plain data for --json."""
    options = found.options
    return {
        "source": options.source.as_posix(),
        "kind": found.kind,
        "measurements": found.measured,
        "missing": found.missing,
        "stamps": len(found.stamps),
        "span_s": float(found.stamps[-1] - found.stamps[0]),
        "model": options.model,
        "process_noise_form": options.form,
        "method": options.method,
        "robust": options.robust,
        "q": found.q,
        "q_estimated": options.q is None,
        "sigma": found.sigma,
        "sigma_estimated": options.sigma is None and bool(found.sigma),
        "residual_rms": found.residual,
        "log_likelihood": found.log_likelihood,
        "consistency": asdict(found.consistency),
        "nis": {name: values.tolist() for name, values in found.nis.items()},
        "outliers": [asdict(outlier) for outlier in found.outliers],
        "evaluation": evaluation(found),
        "written": [path.as_posix() for path in found.written],
    }


def _is_table(options: SmoothOptions) -> bool:
    if options.columns or options.controls is not None:
        if options.source.suffix.lower() != _TABLE_SUFFIX:
            raise InvalidInput("--columns and --input go with a CSV of numbers over time", where=str(options.source))
        return True
    return options.source.suffix.lower() == _TABLE_SUFFIX and not trajectories.is_trajectory_csv(options.source)
