"""File formats of camcal and of other programs; conversions are exact or refused.

Addresses of cameras in files are FILE#NAME.
"""

from pathlib import Path

from camcal.errors import InvalidInput


def split_address(text: str) -> tuple[Path, str | None]:
    """Return the file and the camera of an address such as 'rig.yaml#left'; the camera is None without '#'.

    A file whose own name holds a '#' is found first; a topic of a bag stands for the camera of its namespace. Raises
    InvalidInput if no name follows the '#'.
    """
    path, mark, camera = text.rpartition("#")
    if not mark or Path(text).exists():
        return Path(text), None
    if not path or not camera:
        raise InvalidInput("a camera is addressed as file.yaml#name", where=text)
    if camera.startswith("/"):
        from camcal.formats.cameras.record import name_of_topic  # here: an address alone loads no lens models

        camera = name_of_topic(camera)
    return Path(path), camera
