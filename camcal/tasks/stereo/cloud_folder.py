"""`camcal stereo cloud` on a folder: a cloud for every disparity map in it."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from camcal.errors import FileError
from camcal.formats import disparity, pointclouds
from camcal.progress import SILENT, Outcome, Progress
from camcal.run.fanout import fan_out
from camcal.run.paths import place
from camcal.tasks.stereo import cloud
from camcal.tasks.stereo.cloud import CloudReport, stereo_cloud
from camcal.tasks.stereo.cloud_options import CloudOptions

_SUFFIX = ".ply"


def cloud_folder(options: CloudOptions, progress: Progress = SILENT) -> list[Outcome[Path, CloudReport]]:
    """Return what became of every map in the folder options.disparity; one that fails costs only itself.

    options.output is a folder, an image of options.files a folder of images with the names of the maps.
    Raises InvalidInput if clouds would overwrite maps or each other, FileError if the folder holds no map.
    """
    maps = disparity.maps_in(options.disparity)
    suffix = cloud.GRIDS[0] if options.vertices.organised else _SUFFIX
    outputs = place(maps, options.output, suffix, pointclouds.SUFFIXES)
    work = partial(_one, options=options, outputs=outputs, progress=progress)
    return list(fan_out(work, maps, jobs=options.jobs, what="cloud", progress=progress))


def _one(path: Path, options: CloudOptions, outputs: Mapping[Path, Path], progress: Progress) -> CloudReport:
    named = [_image_of(path, Path(text)) if Path(text).is_dir() else text for text in options.files]
    image, camera_file, *_ = (*named, None, None)
    each = replace(options, disparity=path, output=outputs[path], image=image, camera_file=camera_file, jobs=1)
    return stereo_cloud(each, progress)


def _image_of(path: Path, folder: Path) -> str:
    """Return the image of a folder that has the name of a map."""
    found = sorted(image for image in folder.iterdir() if image.stem == path.stem and image.is_file())
    if len(found) != 1:
        raise FileError(f"holds {len(found)} images named {path.stem}, need one", where=str(folder))
    return str(found[0])


def document(outcomes: list[Outcome[Path, CloudReport]]) -> dict[str, Any]:
    """Return what became of the maps as plain data for --json."""
    return {
        "clouds": [cloud.document(outcome.value) for outcome in outcomes if outcome.value is not None],
        "failed": [
            {"source": outcome.item.as_posix(), "message": str(outcome.error)} for outcome in outcomes if outcome.error
        ],
    }
