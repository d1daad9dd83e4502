"""PLY as others write and read it; the reader here knows only the description of the format."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError
from camcal.formats.pointclouds import ply, write
from camcal.stereo.depth import VertexStream, vertex_type

TYPES = {b"float": "<f4", b"uchar": "u1"}
SQUARE = b"0 0 5\n1 0 5\n1 1 5\n"


def independently_read(path):
    """Return the header lines and the columns of a file by name."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = header.splitlines()
    count = next(int(line.split()[2]) for line in lines if line.startswith(b"element vertex"))
    fields = [(line.split()[2].decode(), TYPES[line.split()[1]]) for line in lines if line.startswith(b"property")]
    if b"format ascii 1.0" in lines:
        rows = [row.split() for row in body.splitlines()]
        assert len(rows) == count
        return lines, {name: np.array([row[i] for row in rows], float) for i, (name, _) in enumerate(fields)}
    vertices = np.frombuffer(body, np.dtype(fields))
    assert len(vertices) == count
    return lines, {name: vertices[name] for name, _ in fields}


def ply_of(body, *lines, form="ascii"):
    return "\n".join(["ply", f"format {form} 1.0", *lines, "end_header", ""]).encode() + body


XYZ = ("element vertex 3", "property float x", "property float y", "property float z")


@pytest.mark.parametrize("ascii_text", [False, True])
@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("intensity", [False, True])
def test_a_file_holds_the_cloud_bit_for_bit(tmp_path, vertices, stream, ascii_text, colour, intensity):
    cloud = vertices(50, colour=colour, intensity=intensity)
    write(tmp_path / "cloud.ply", stream(cloud), ascii_text=ascii_text)
    _, columns = independently_read(tmp_path / "cloud.ply")
    assert tuple(columns) == cloud.dtype.names
    for name, values in columns.items():
        np.testing.assert_array_equal(values.astype(cloud.dtype[name]), cloud[name])


def test_a_coloured_vertex_takes_fifteen_bytes(tmp_path, vertices, stream):
    write(tmp_path / "cloud.ply", stream(vertices(100, colour=True)))
    assert len((tmp_path / "cloud.ply").read_bytes().split(b"end_header\n", 1)[1]) == 1500


def test_the_header_says_unit_frame_and_notes(tmp_path, vertices, stream):
    write(tmp_path / "cloud.ply", stream(vertices(1), unit="mm", notes={"baseline_m": "0.537\nend"}))
    lines, _ = independently_read(tmp_path / "cloud.ply")
    assert b"comment unit: mm" in lines
    assert b"comment frame: left camera: x right, y down, z forward" in lines
    assert b"comment baseline_m: 0.537 end" in lines


@given(count=st.integers(0, 40), flags=st.tuples(*[st.booleans()] * 4), seed=st.integers(0, 99))
def test_any_bits_come_back(tmp_path_factory, count, flags, seed):
    kind = vertex_type(colour=flags[0], intensity=flags[1], normals=flags[2], sigma=flags[3])
    cloud = np.frombuffer(np.random.default_rng(seed).bytes(count * kind.itemsize), kind)
    path = tmp_path_factory.getbasetemp() / "any.ply"
    write(path, VertexStream(count, kind, [cloud]))
    assert ply.read(path.read_bytes()).vertices.tobytes() == cloud.tobytes()


@pytest.mark.parametrize(("form", "order"), [("binary_little_endian", "<"), ("binary_big_endian", ">")])
def test_either_byte_order_and_any_type_of_number_is_read(form, order):
    kind = np.dtype([("x", "f8"), ("y", "i2"), ("z", "u4"), ("quality", "i1")]).newbyteorder(order)
    body = np.array([(0.5, -3, 7, 1), (1.5, 4, 8, 2)], kind).tobytes()
    names = ("property double x", "property int16 y", "property uint z", "property char quality")
    found = ply.read(ply_of(body, "element vertex 2", *names, form=form)).vertices
    assert found.dtype == vertex_type()
    assert found.tolist() == [(0.5, -3, 7), (1.5, 4, 8)]


@pytest.mark.parametrize(
    "names", [("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue")]
)
@pytest.mark.parametrize(("kind", "row"), [("uchar", "255 128 0"), ("float", "1 0.502 0"), ("ushort", "65535 32896 0")])
def test_colours_are_read_under_the_names_and_in_the_ranges_of_others(names, kind, row):
    lines = [*XYZ, *(f"property {kind} {name}" for name in names)]
    found = ply.read(ply_of(f"0 0 1 {row}\n".encode() * 3, *lines)).vertices
    assert found[["red", "green", "blue"]].tolist() == [(255, 128, 0)] * 3


def test_faces_behind_the_vertices_are_passed_over():
    lines = (*XYZ, "element face 1", "property list uchar int vertex_indices")
    found = ply.read(ply_of(SQUARE + b"3 0 1 2\n", *lines))
    assert found.vertices["x"].tolist() == [0, 1, 1]


def test_elements_in_front_of_the_vertices_are_passed_over():
    camera = ("element camera 1", "property double fx", "property double fy")
    found = ply.read(ply_of(b"700 700\n" + SQUARE, *camera, *XYZ))
    assert found.vertices["x"].tolist() == [0, 1, 1]
    binary = np.array([700.0, 700.0]).tobytes() + np.arange(9, dtype="<f4").tobytes()
    found = ply.read(ply_of(binary, *camera, *XYZ, form="binary_little_endian"))
    assert found.vertices["x"].tolist() == [0, 3, 6]


def test_lines_may_end_as_windows_ends_them():
    found = ply.read(ply_of(SQUARE, *XYZ).replace(b"\n", b"\r\n"))
    assert found.vertices["y"].tolist() == [0, 0, 1]


def test_coordinates_of_a_map_keep_their_digits_behind_an_origin():
    lines = ("element vertex 2", "property double x", "property double y", "property double z")
    found = ply.read(ply_of(b"500000.01 4649776.02 12\n500001.01 4649777.02 13\n", *lines))
    assert found.notes["origin"] == "500000 4649776 0"
    # float64 holds 4649776.02 to 1e-9, float32 holds 1.02 to 1e-7
    np.testing.assert_allclose(found.vertices.tolist(), [(0.01, 0.02, 12), (1.01, 1.02, 13)], rtol=0, atol=2e-7)


def test_comments_of_other_programs_are_left_out():
    found = ply.read(ply_of(SQUARE, "comment made by hand", "comment unit: millimetres", *XYZ))
    assert (found.unit, found.frame, found.notes) == ("mm", "", {})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"solid stl", "not a PLY file"),
        (b"ply\nformat ascii 1.0\n", "not a PLY file"),
        (ply_of(b"", "element face 0"), "without vertices"),
        (ply_of(b"", "element vertex many"), "line 3 of the PLY header"),
        (ply_of(b"", "element vertex 1", "property half x"), "line 4 .* property half x"),
        (b"ply\nelement vertex 0\nend_header\n", "no line format"),
        (ply_of(b"1\n", "element vertex 1", "property float x"), "no x, y and z; its columns are x"),
        (ply_of(b"", "element vertex 1", "property float x", "property float x"), "two properties x"),
        (ply_of(SQUARE, *XYZ, "property list uchar int near"), "list near is not read"),
        (ply_of(SQUARE, "element vertex 4", *XYZ[1:]), "4 vertices end on line 4, there are 3 lines"),
        (ply_of(b"1 2\n" * 3, *XYZ), "3 numbers by the header, a row has 2"),
        (ply_of(b"1 2 here\n" * 3, *XYZ), "not a table of numbers: .* column 3$"),
        (
            ply_of(bytes(35), *XYZ, form="binary_little_endian"),
            "3 vertices end 36 bytes after the header, the file has 35",
        ),
    ],
)
def test_a_file_that_is_none_says_what_was_expected_and_found(content, message):
    with pytest.raises(FileError, match=message):
        ply.read(content)
