"""Disparity maps with the truth they are held against: one of each, or folders of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from camcal.errors import InvalidInput
from camcal.formats.disparity import maps_in
from camcal.run.inputs import require_there
from camcal.run.pairs import paired
from camcal.tasks.stereo.options import TruthPair


def truth_pairs(given: TruthPair) -> list[TruthPair]:
    """Return the pairs that files or folders stand for; the files of folders belong together as `paired` says.

    Raises InvalidInput if files and folders are mixed or the files of folders do not pair up, FileError for what is
    not there or empty.
    """
    for path in given.files.values():
        require_there(path)
    folders = {name: path.is_dir() for name, path in given.files.items()}
    if not any(folders.values()):
        return [given]
    if not all(folders.values()):
        file = next(path for name, path in given.files.items() if not folders[name])
        raise InvalidInput("is no folder, while others are; give files only or folders only", where=str(file))
    maps = maps_in(given.disparity)
    partners = {name: _partners(maps, given.disparity, folder) for name, folder in given.files.items()}
    return [TruthPair(**{name: found[path] for name, found in partners.items()}) for path in maps]


def _partners(maps: Sequence[Path], home: Path, folder: Path) -> Mapping[Path, Path]:
    """Return the file of a folder that belongs to each map."""
    return dict(paired(maps, maps_in(folder), (f"maps in {home}", f"files in {folder}")))
