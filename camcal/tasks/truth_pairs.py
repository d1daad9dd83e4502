"""Disparity maps with the truth they are held against: one of each, or folders of them."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

from camcal.errors import FileError, InvalidInput
from camcal.files import natural_key
from camcal.formats import disparity_sidecar
from camcal.formats.disparity import SUFFIXES
from camcal.run.inputs import require_there


@dataclass(frozen=True)
class TruthPair:
    """The files that belong to one disparity map; as options, folders of them.

    truth: of the left image. mask: what both cameras see. right_truth: of the right image, which tells that as well.
    sigma, confidence: the uncertainty and the class of every pixel.
    """

    disparity: Path
    truth: Path
    mask: Path | None = None
    right_truth: Path | None = None
    sigma: Path | None = None
    confidence: Path | None = None

    @property
    def files(self) -> Mapping[str, Path]:
        """What there is, by name."""
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: path for name, path in found.items() if path is not None}


def find_pairs(given: TruthPair) -> list[TruthPair]:
    """Return the pairs that files or folders stand for; the files of folders belong together in natural order.

    Raises InvalidInput if files and folders are mixed or hold different numbers of files, FileError for what is not
    there or empty.
    """
    for path in given.files.values():
        require_there(path)
    folders = {name: path.is_dir() for name, path in given.files.items()}
    if not any(folders.values()):
        return [given]
    if not all(folders.values()):
        file = next(path for name, path in given.files.items() if not folders[name])
        raise InvalidInput("is no folder, while others are; give files only or folders only", where=str(file))
    found = {name: _maps(folder) for name, folder in given.files.items()}
    counts = {name: len(paths) for name, paths in found.items()}
    if len(set(counts.values())) > 1:
        held = ", ".join(f"{given.files[name]} {count}" for name, count in counts.items())
        raise InvalidInput(f"folders must hold as many files each, found {held}")
    names = list(found)
    return [TruthPair(**dict(zip(names, paths, strict=True))) for paths in zip(*found.values(), strict=True)]


def _maps(folder: Path) -> list[Path]:
    """Return the maps of a folder in natural order; where some have a sidecar, those are the maps."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.name[0] != "."]
    told = [path for path in files if disparity_sidecar.path_beside(path).is_file()]
    if not files:
        raise FileError(f"holds no map ({', '.join(SUFFIXES)})", where=str(folder))
    return sorted(told or files, key=lambda path: natural_key(path.name))
