"""GLB by the rules of glTF 2.0: chunks, alignment, extents, the node that turns the cloud upright, linear colour."""

import json
import struct

import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput
from camcal.formats.pointclouds import write
from camcal.formats.pointclouds.glb import _description, _type_of, read
from camcal.stereo.depth import VertexStream


def chunks_of(content):
    """Return the description and the binary part, checking the container on the way."""
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    assert (kind, size % 4) == (b"JSON", 0)
    rest = content[20 + size :]
    binary_size, binary_kind = struct.unpack_from("<I4s", rest)
    assert (binary_kind, binary_size % 4, binary_size) == (b"BIN\0", 0, len(rest) - 8)
    return json.loads(content[20 : 20 + size]), rest[8:]


def glb_of(document, binary=b""):
    text = json.dumps(document).encode()
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def points_of(count=2, **changes):
    """Return the description of plain float positions as another program may write it."""
    accessor = {"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"} | changes
    mesh = {"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 9}}]}
    return {"nodes": [{"mesh": 0}], "meshes": [mesh], "accessors": [accessor], "bufferViews": [{"buffer": 0}]}


@pytest.fixture
def written(tmp_path, stream):
    def written(vertices, **words):
        write(tmp_path / "cloud.glb", stream(vertices, **words))
        return chunks_of((tmp_path / "cloud.glb").read_bytes())

    return written


def test_points_are_one_primitive_with_its_extent(vertices, written):
    cloud = vertices(20, colour=True, intensity=True, normals=True, sigma=True)
    document, binary = written(cloud)
    primitive = document["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    assert list(primitive["attributes"]) == ["POSITION", "COLOR_0", "NORMAL", "_INTENSITY", "_SIGMA"]
    position = document["accessors"][primitive["attributes"]["POSITION"]]
    assert position["min"] == [float(cloud[axis].min()) for axis in "xyz"]
    assert position["max"] == [float(cloud[axis].max()) for axis in "xyz"]
    assert document["buffers"] == [{"byteLength": len(binary)}]
    assert all(accessor["byteOffset"] % 4 == 0 for accessor in document["accessors"])


def test_vertices_without_a_position_are_left_out(vertices, written):
    cloud = vertices(5)
    cloud["z"][2] = np.nan
    document, binary = written(cloud)
    assert document["accessors"][0]["count"] == 4
    assert len(binary) == 48


@pytest.mark.parametrize(
    ("frame", "upright"),
    [
        ("left camera: x right, y down, z forward", (1, -2, -3)),
        ("left camera: x forward, y left, z up", (-2, 3, -1)),
        ("left camera: x right, y up, z backward", (1, 2, 3)),
        ("world: x east, y north, z up", (1, 3, -2)),
        ("somewhere", (1, -2, -3)),
    ],
)
@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("mm", 1e-3)])
def test_the_node_turns_the_cloud_upright_and_into_metres(vertices, written, frame, upright, unit, metres):
    document, _ = written(vertices(1), frame=frame, unit=unit)
    matrix = np.reshape(document["nodes"][0]["matrix"], (4, 4)).T  # glTF has columns first
    np.testing.assert_allclose(matrix @ [1, 2, 3, 1], [*np.multiply(upright, metres), 1], rtol=0, atol=1e-15)


def test_colour_is_linear_light_and_every_shade_comes_back(tmp_path, vertices, stream, written):
    cloud = vertices(256, colour=True)
    cloud["red"] = cloud["green"] = cloud["blue"] = np.arange(256)
    document, binary = written(cloud)
    accessor = document["accessors"][1]
    assert (accessor["componentType"], accessor["normalized"]) == (5123, True)
    counts = np.frombuffer(binary, "<u2").reshape(256, -1)[:, accessor["byteOffset"] // 2 :][:, :4]
    assert counts[188].tolist() == [*[round(0.50289 * 65535)] * 3, 65535]  # IEC 61966-2-1: 188 is 0.50289
    found = read((tmp_path / "cloud.glb").read_bytes()).vertices
    np.testing.assert_array_equal(found["green"], np.arange(256))


def test_an_empty_cloud_has_no_mesh(vertices, written):
    document, binary = written(vertices(0))
    assert "meshes" not in document
    assert binary == b""


def test_more_than_four_gibibytes_are_refused_before_anything_is_written(tmp_path, vertices):
    with pytest.raises(InvalidInput, match=r"4 GiB.*write \.ply"):
        write(tmp_path / "cloud.glb", VertexStream(1 << 30, vertices(0).dtype, ()))
    assert list(tmp_path.iterdir()) == []


def test_plain_points_of_another_program_are_read():
    found = read(glb_of(points_of(), np.arange(6, dtype="<f4").tobytes()))
    assert found.vertices.tolist() == [(0, 1, 2), (3, 4, 5)]
    assert (found.unit, found.frame) == ("m", "")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"glTF", "not a GLB file"),
        (struct.pack("<4sII", b"glTF", 1, 12), "only glTF 2 is read"),
        (struct.pack("<4sII", b"glTF", 2, 99), "of 99 bytes; found 12 bytes"),
        (struct.pack("<4sII", b"glTF", 2, 12), "the GLB file has no readable JSON"),
        (glb_of([]), "the GLB file contains no points"),
        (glb_of(points_of(type="MAT2"), bytes(24)), "the GLB file contains no points"),
        (glb_of(points_of(count=-1), bytes(24)), "points end"),
        (glb_of(points_of(), bytes(23)), "2 points end 24 bytes into .* which has 23"),
    ],
)
def test_a_file_that_is_none_says_what_was_expected_and_found(content, message):
    with pytest.raises(FileError, match=message):
        read(content)


def test_the_room_for_the_description_fits_the_longest_extents(vertices):
    kind = _type_of(VertexStream(1, vertices(1).dtype, ()))
    longest = np.full((2, 3), np.finfo(np.float32).min)
    stream = VertexStream(1, vertices(1).dtype, ())
    room = len(_description(stream, kind, 1, longest))
    rng = np.random.default_rng(0)
    for bits in rng.integers(0, 1 << 32, (200, 6), dtype=np.uint32):
        extent = np.nan_to_num(bits.view(np.float32)).reshape(2, 3)
        assert len(_description(stream, kind, 1, extent)) <= room
