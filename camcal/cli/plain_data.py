"""What commands print with --json as plain data."""

import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

_SIGNIFICANT_DIGITS = 12


def plain(value: Any) -> Any:
    """Return a value as JSON takes it: 12 significant digits, null for NaN, lists for arrays, texts for paths."""
    if hasattr(value, "tolist"):  # numpy arrays and scalars, without importing numpy
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{_SIGNIFICANT_DIGITS}g}") if math.isfinite(value) else None
    return str(value) if isinstance(value, PurePath) else value
