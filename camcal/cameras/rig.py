"""Cameras that are fixed to each other."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras by name and where each stands: rig_T_camera takes points of a camera's frame to the rig's, metres."""

    cameras: Mapping[str, Camera]
    rig_T_camera: Mapping[str, Pose]

    def __post_init__(self) -> None:
        if not self.cameras:
            raise InvalidInput("a rig has one camera or more")
        without = [name for name in self.cameras if name not in self.rig_T_camera]
        if without:
            raise InvalidInput(f"nothing says where camera {without[0]!r} stands in the rig")
        object.__setattr__(self, "cameras", MappingProxyType(dict(self.cameras)))
        object.__setattr__(self, "rig_T_camera", MappingProxyType(dict(self.rig_T_camera)))
