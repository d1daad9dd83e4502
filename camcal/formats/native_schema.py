"""What a camera file may hold: every rule of the native YAML, checked before anything is built from it."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import CameraModel
from camcal.formats import covariance, provenance
from camcal.formats.native_parts import check_board_shape, check_joint_covariance, check_transforms
from camcal.formats.schema import did_you_mean, flag, integer, items, mapping, number, one_of, plain, text
from camcal.formats.strict_yaml import Check, Fault, child

FORMAT = "camcal-calibration"
VERSION = 1
CORE = ("fx", "fy", "cx", "cy", "skew")  # named under intrinsics, all others under distortion

_MIRRORED = " (mirrored image? flip the image instead)"
_RANGES: Mapping[str, Check] = {
    "fx": number(above=0, hint=_MIRRORED),
    "fy": number(above=0, hint=_MIRRORED),
    "tau_x": number(-math.pi / 2, math.pi / 2),
    "tau_y": number(-math.pi / 2, math.pi / 2),
}
_POSITIVE, _SHARE, _COUNT = number(above=0), number(0, 1), integer(0)
