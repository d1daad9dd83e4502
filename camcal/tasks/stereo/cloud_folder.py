"""`camcal stereo cloud` of a folder: every disparity map, or every unrectified pair, to a point cloud."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from camcal.errors import FileError
from camcal.formats import disparity, pointclouds
from camcal.progress import SILENT, Outcome, Progress, warn_of
from camcal.run.fanout import fan_out
from camcal.run.outputs import claim
from camcal.run.paths import find_pairs, place
from camcal.tasks.stereo.cloud import GRIDS, CloudReport, document, make_cloud, rig_of_cloud
from camcal.tasks.stereo.cloud_options import CloudOptions
from camcal.tasks.stereo.rig_pair import RigPair

_SUFFIX = ".ply"


class _Item(NamedTuple):
    """A map and its cloud; or the left image of a pair that is to be rectified, the cloud, and the right image.

    images: those of its name in every folder of images.
    """

    path: Path
    output: Path
    right: Path | None
    images: Mapping[str, Sequence[Path]]


def cloud_folder(options: CloudOptions, progress: Progress = SILENT) -> list[Outcome[Path, CloudReport]]:
    """Return what became of every map in the folder options.disparity; one that fails costs only itself.

    options.output is a folder, an image of options.files a folder of images with the names of the maps. With a rig file
    both are folders of unrectified images, and there is a cloud for each pair.
    Raises InvalidInput if clouds would overwrite maps or each other, FileError if the folder holds no map.
    """
    rig = rig_of_cloud(options, progress)
    work = partial(_make, options=options, rig=rig)
    items = _pairs(options) if rig is not None else _maps(options)
    found = []
    for outcome in fan_out(work, items, jobs=options.jobs, batch=options.batch, what="cloud", progress=progress):
        if outcome.value is not None:
            warn_of(outcome.value.warnings, progress)
        found.append(Outcome(outcome.item.path, outcome.value, outcome.error))
    return found


def _pairs(options: CloudOptions) -> list[_Item]:
    pairs = dict(find_pairs([options.disparity], [str(options.image)]))
    outputs = _outputs(list(pairs), options)
    return [_Item(left, outputs[left], right, {}) for left, right in pairs.items()]


def _maps(options: CloudOptions) -> list[_Item]:
    maps = disparity.maps_in(options.disparity)
    outputs = _outputs(maps, options)
    listed = {text: _by_stem(Path(text)) for text in options.files if Path(text).is_dir()}
    return [
        _Item(path, outputs[path], None, {text: images.get(path.stem, ()) for text, images in listed.items()})
        for path in maps
    ]


def _outputs(sources: Sequence[Path], options: CloudOptions) -> Mapping[Path, Path]:
    suffix = GRIDS[0] if options.vertices.organised else _SUFFIX
    outputs = place(sources, options.output, suffix, pointclouds.SUFFIXES)
    claim(outputs.values())
    return outputs


def _by_stem(folder: Path) -> dict[str, list[Path]]:
    """Return the files of a folder by their names without suffix."""
    found: dict[str, list[Path]] = {}
    for path in folder.iterdir():
        if path.is_file():
            found.setdefault(path.stem, []).append(path)
    return found


def _make(item: _Item, options: CloudOptions, rig: RigPair | None) -> CloudReport:
    each = replace(options, disparity=item.path, output=item.output, jobs=1)
    if rig is not None:
        return make_cloud((item.path, replace(each, image=str(item.right))), rig)
    named = [_image_of(item, text) if text in item.images else text for text in options.files]
    image, camera_file, *_ = (*named, None, None)
    return make_cloud((item.path, replace(each, image=image, camera_file=camera_file)), None)


def _image_of(item: _Item, folder: str) -> str:
    """Return the image of a folder that has the name of a map."""
    found = item.images[folder]
    if len(found) != 1:
        raise FileError(f"holds {len(found)} images named {item.path.stem}, need one", where=folder)
    return str(found[0])


def folder_document(outcomes: list[Outcome[Path, CloudReport]]) -> dict[str, Any]:
    """Return what became of the maps as plain data for --json."""
    return {
        "clouds": [document(outcome.value) for outcome in outcomes if outcome.value is not None],
        "failed": [
            {"source": outcome.item.as_posix(), "message": str(outcome.error)} for outcome in outcomes if outcome.error
        ],
    }
