"""camcal's own camera file as one of the formats; see formats.native."""

from collections.abc import Sequence
from pathlib import Path

from camcal import files
from camcal.errors import InvalidInput
from camcal.formats import documents, native
from camcal.formats.camera_file import CameraFile
from camcal.formats.cameras.record import EVERY_LENS, CameraFormat, Given, Source


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the content of a camera file; raises as `native.read` does, and for another size than the file's."""
    (source,) = sources
    where = str(source.path)
    file = native.from_document(documents.parse(source.text, where, native.check), source.path.parent)
    for entry in file.cameras.values():
        given.size(entry.camera.image_size, where)
    return file


def write(path: Path, file: CameraFile) -> None:
    """Write a camera file with all digits of its numbers; raises as `native.write` does."""
    if path.suffix.lower() not in CAMCAL.suffixes and not files.is_stream(path):
        raise InvalidInput("a camera file of camcal is .yaml", where=str(path))
    native.write(path, file, exact=True)


CAMCAL = CameraFormat(
    name="camcal",
    title="camcal's own",
    suffixes=(".yaml", ".yml"),
    models=EVERY_LENS,
    read=read,
    write=write,
)
