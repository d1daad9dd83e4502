"""`camcal stereo cloud`: a disparity map or an unrectified pair, or every one of a folder, to a point cloud."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from camcal.errors import FileError
from camcal.formats import disparity, disparity_sidecar, pointclouds
from camcal.progress import SILENT, Outcome, Progress, failed_items, reused, warn_of
from camcal.run import fingerprint
from camcal.run.outputs import claim, writes
from camcal.run.paths import find_pairs, place, require_there
from camcal.run.resume import Items, resumable
from camcal.tasks.stereo.cloud import GRIDS, CloudReport, make_cloud, rig_of_cloud
from camcal.tasks.stereo.rig_pair import RigPair
from camcal.tasks.stereo.run_options import CloudOptions

_SUFFIX = ".ply"


class _Item(NamedTuple):
    """A map and its cloud; or the left image of a pair that is to be rectified, the cloud, and the right image.

    images: those of its name in every folder of images.
    """

    path: Path
    output: Path
    right: Path | None
    images: Mapping[str, Sequence[Path]]


@writes
def stereo_cloud(options: CloudOptions, progress: Progress = SILENT) -> CloudReport:
    """Return what was written to options.output.

    Raises InvalidInput for a geometry that is incomplete or not rectified, sizes that differ, and for what is asked of
    a point and not known; FileError.
    """
    require_there(options.disparity)
    rig = rig_of_cloud(options, progress)
    claim([options.output])
    right = None if rig is None else Path(str(options.image))
    items = [_Item(options.disparity, options.output, right, {})]
    [outcome] = _outcomes(items, options, rig, progress, alone=True)
    assert outcome.value is not None
    return replace(outcome.value, reused=outcome.reused)


@writes
def cloud_folder(options: CloudOptions, progress: Progress = SILENT) -> list[Outcome[Path, CloudReport]]:
    """Return what became of every map in the folder options.disparity; one that fails costs only itself.

    options.output is a folder, an image of options.files a folder of images with the names of the maps. With a rig file
    both are folders of unrectified images, and there is a cloud for each pair.
    Raises InvalidInput if clouds would overwrite maps or each other, FileError if the folder holds no map.
    """
    rig = rig_of_cloud(options, progress)
    items = _pairs(options) if rig is not None else _maps(options)
    return list(_outcomes(items, options, rig, progress))


def _outcomes(
    items: Sequence[_Item], options: CloudOptions, rig: RigPair | None, progress: Progress, *, alone: bool = False
) -> Iterator[Outcome[Path, CloudReport]]:
    """Yield what becomes of every cloud, after giving its warnings; raises what keeps a single one from being made."""
    own = options if alone else replace(options, jobs=1)
    work = partial(_make, options=own, rig=rig)
    settings = fingerprint.of_settings(options, without=("disparity",))
    made: Items[_Item, CloudReport] = Items(
        settings, partial(_inputs, options=own), lambda item: [item.output], CloudReport
    )
    jobs, batch = options.jobs, options.batch
    for outcome in resumable(work, items, made, jobs=jobs, batch=batch, what="cloud", progress=progress, alone=alone):
        if outcome.value is not None:
            warn_of(outcome.value.warnings, progress)
        yield outcome.of(outcome.item.path)


def _inputs(item: _Item, options: CloudOptions) -> list[Path | str]:
    """Return a pair, or a map with all files that belong to it: its sidecar and those named there, its image.

    The cloud holds the name of the map.
    """
    if item.right is not None:
        return [item.path, item.right, item.path.name]
    sidecar = disparity_sidecar.read(item.path)
    beside = (sidecar.image, sidecar.sigma, sidecar.confidence) if sidecar else ()
    known = [disparity_sidecar.path_beside(item.path), *map(Path, _named(item, options)), *filter(None, beside)]
    return [item.path, *(each for each in known if each.is_file()), item.path.name]


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
    each = replace(options, disparity=item.path, output=item.output)
    if rig is not None:
        return make_cloud((item.path, replace(each, image=str(item.right))), rig)
    image, camera_file, *_ = (*_named(item, options), None, None)
    return make_cloud((item.path, replace(each, image=image, camera_file=camera_file)), None)


def _named(item: _Item, options: CloudOptions) -> list[str]:
    """Return the image and the camera file that go with a map, as far as they are given."""
    return [_image_of(item, text) if text in item.images else text for text in options.files]


def _image_of(item: _Item, folder: str) -> str:
    """Return the image of a folder that has the name of a map."""
    found = item.images[folder]
    if len(found) != 1:
        raise FileError(f"holds {len(found)} images named {item.path.stem}, need one", where=folder)
    return str(found[0])


def folder_document(outcomes: list[Outcome[Path, CloudReport]]) -> dict[str, Any]:
    """Return what became of the maps as plain data for --json."""
    return {
        "clouds": [outcome.value for outcome in outcomes if outcome.value is not None],
        "reused": reused(outcomes),
        "failed": failed_items(outcomes, "source"),
    }
