"""When cameras took their images, as text and as plain data."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from camcal.report.table import value_and_std

if TYPE_CHECKING:
    from camcal.calibrate.timing.record import CameraTime, CameraTimes


def time_lines(times: "CameraTimes | None") -> Iterator[str]:
    """Yield the times of cameras, a line each."""
    if times is None:
        return
    for name, own in times.cameras.items():
        if own.offset_std:
            offset, std = value_and_std(1e3 * own.offset, 1e3 * own.offset_std)
            rate, rate_std = value_and_std(1e6 * own.rate, 1e6 * own.rate_std)
            frames = f"{own.offset / times.interval:+.4f} frames"
            yield f"Time offset of {name}: {offset} ± {std} ms ({frames}), clock rate {rate} ± {rate_std} ppm"
        if own.middle_offset is not None:
            offset, std = value_and_std(1e3 * own.middle_offset, 1e3 * own.middle_offset_std)
            yield f"Time offset of {name} between the middle rows: {offset} ± {std} ms"
        if own.readout is not None:
            readout, std = value_and_std(1e3 * own.readout, 1e3 * own.readout_std)
            yield f"Readout time{f' of {name}' if name else ''}: {readout} ± {std} ms"


def times_data(times: "CameraTimes | None") -> dict[str, dict[str, float]] | None:
    """Return the times of cameras as plain data by their names, as the camera file has them; None without any."""
    return None if times is None else {name: time_data(own) for name, own in times.cameras.items()}


def time_data(own: "CameraTime") -> dict[str, float]:
    """Return the times of a camera by the keys of a camera file."""
    clock = {
        "offset_s": own.offset,
        "offset_std_s": own.offset_std,
        "rate": own.rate,
        "rate_std": own.rate_std,
        "reference_s": own.reference,
    }
    shutter = {} if own.readout is None else {"readout_s": own.readout, "readout_std_s": own.readout_std}
    middle = (
        {}
        if own.middle_offset is None
        else {"middle_offset_s": own.middle_offset, "middle_offset_std_s": own.middle_offset_std}
    )
    return (clock if own.offset_std else {}) | shutter | middle
