"""A network of the user's own: tiny models that are run for real by whatever runtime is installed.

What is not proven: that any trained network keeps the contract.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx_bytes import difference, field, model, node, tensor

from camcal.errors import CamcalError, FileError, InvalidInput
from camcal.stereo.matching import learned
from camcal.stereo.matching.learned import learned_disparity, read_graph

GRAY = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601, red first
IMAGE = (1, 3, "rows", "columns")
MAP = (1, 1, "rows", "columns")
ROUNDING = 1e-4  # sums of three float32 numbers up to 255


@pytest.fixture
def network(tmp_path):
    def network(content):
        (tmp_path / "network.onnx").write_bytes(content)
        return tmp_path / "network.onnx"

    return network


@pytest.fixture
def pair():
    rng = np.random.default_rng(4)
    return rng.integers(128, 256, (50, 70, 3), dtype=np.uint8), rng.integers(0, 128, (50, 70, 3), dtype=np.uint8)


def test_the_output_of_the_model_is_the_disparity_pixel_by_pixel(network, pair):
    left, right = pair
    found = learned_disparity(left, right, network(difference()))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, left.mean(2) - right.mean(2), rtol=0, atol=ROUNDING)


def test_white_may_be_one(network, pair):
    left, right = pair
    found = learned_disparity(left, right, network(difference()), white=1.0)
    np.testing.assert_allclose(found, (left.mean(2) - right.mean(2)) / 255, rtol=0, atol=ROUNDING / 255)


@pytest.mark.parametrize(("blue_first", "channel"), [(False, 2), (True, 0)])
def test_red_comes_first_unless_blue_is_asked_for(network, pair, blue_first, channel):
    nodes = [
        node("Sub", ["left", "right"], "difference"),
        node("ArgMax", ["difference"], "largest", axis=1, keepdims=1),
        node("Cast", ["largest"], "out", to=1),
    ]
    first = network(model(nodes, [tensor("left", *IMAGE), tensor("right", *IMAGE)], [tensor("out", *MAP)]))
    left, right = np.zeros((2, 32, 32, 3), np.uint8)
    left[..., channel] = 200
    found = learned_disparity(left, right, first, blue_first=blue_first)
    assert (found == 0).all()


def test_a_model_of_one_channel_gets_gray(network, pair):
    left, right = pair
    found = learned_disparity(left, right, network(difference(channels=1)))
    np.testing.assert_allclose(found, (left - 1.0 * right)[..., ::-1] @ GRAY, rtol=0, atol=0.01)  # BT.601 to 3 digits


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("depth", "white"), [(np.uint8, 255), (np.uint16, 65535), (np.float32, 1.0)])
def test_gray_images_of_any_depth_are_taken(network, channels, depth, white):
    left = np.full((32, 40), white, depth)
    found = learned_disparity(left, np.zeros_like(left), network(difference(channels=channels)))
    np.testing.assert_allclose(found, 255, rtol=1e-6)  # float32


def test_the_model_sees_edges_repeated_up_to_multiples_of_32(network, pair, monkeypatch):
    left, right = pair
    seen = {}
    run = learned._by_onnxruntime if learned.find_spec("onnxruntime") else learned._by_opencv

    def watched(model, feeds):
        seen.update(feeds)
        return run(model, feeds)

    monkeypatch.setattr(learned, run.__name__, watched)
    learned_disparity(left, right, network(difference()))
    assert seen["left"].shape == (1, 3, 64, 96)
    assert (seen["left"][0, :, 50:, :70] == seen["left"][0, :, 49:50, :70]).all()
    assert (seen["left"][0, :, :, 70:] == seen["left"][0, :, :, 69:70]).all()


def test_a_model_of_fixed_size_gets_that_size(network, pair):
    left, right = pair
    found = learned_disparity(left, right, network(difference(rows=100, columns=72)))
    np.testing.assert_allclose(found, left.mean(2) - right.mean(2), rtol=0, atol=ROUNDING)
    with pytest.raises(InvalidInput, match="images of 64 × 100 pixels, these are 70 × 50"):
        learned_disparity(left, right, network(difference(rows=100, columns=64)))


def test_images_of_two_sizes_are_refused(network, pair):
    with pytest.raises(InvalidInput, match="the left image is 70 × 50, the right one 69 × 50"):
        learned_disparity(pair[0], pair[1][:, 1:], network(difference()))


def test_a_model_with_the_sign_reversed_is_refused(network, pair):
    with pytest.raises(InvalidInput, match="all disparities of the model are negative"):
        learned_disparity(pair[1], pair[0], network(difference()))


SUM = node("Add", ["left", "right"], "out")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (model([], [tensor("both", 1, 6, "h", "w")], [tensor("out", *MAP)]), r"found both 1 × 6 × \? × \? to out"),
        (model([SUM], [tensor("left", *IMAGE), tensor("right", *IMAGE)], []), "to nothing"),
        (model([SUM], [tensor("left", *IMAGE), tensor("right", 3, 4)], [tensor("out", *MAP)]), "found right 3 × 4"),
        (model([SUM], [tensor("left", 2, 3, 4, 4), tensor("right", *IMAGE)], [tensor("out", *MAP)]), "found left 2 ×"),
        (
            model([SUM], [tensor("left", *IMAGE), tensor("right", *IMAGE, element=10)], [tensor("out", *MAP)]),
            "right must be float32",
        ),
        (
            model([SUM], [tensor("left", 1, 3, 64, 64), tensor("right", 1, 3, 64, 32)], [tensor("out", *MAP)]),
            "the inputs have two sizes",
        ),
        (
            model([SUM], [tensor("left", *IMAGE), tensor("right", *IMAGE)], [tensor("out", *IMAGE)]),
            "the output must be 1 × 1 × 64 × 96, found 1 × 3 × 64 × 96",
        ),
        (
            model(
                [node("NoSuchOperation", ["left", "right"], "out")],
                [tensor("left", *IMAGE), tensor("right", *IMAGE)],
                [tensor("out", *MAP)],
            ),
            "cannot run the model",
        ),
    ],
)
def test_a_model_that_breaks_the_contract_says_where(network, pair, content, message, capfd):
    path = network(content)
    with pytest.raises(InvalidInput, match=message) as caught:
        learned_disparity(*pair, path)
    assert caught.value.where == str(path)
    assert "\n" not in caught.value.message
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("content", [b"garbage", b"\x00", field(1, 7), difference()[:-1], difference()[:40]])
def test_a_file_that_is_no_model_is_a_file_error(network, pair, content):
    with pytest.raises(FileError, match="not an ONNX model, or truncated"):
        learned_disparity(*pair, network(content))


def test_a_missing_and_an_empty_file_are_file_errors(tmp_path, network, pair):
    with pytest.raises(FileError, match="no such file"):
        learned_disparity(*pair, tmp_path / "none.onnx")
    with pytest.raises(FileError, match="is empty"):
        learned_disparity(*pair, network(b""))


def test_weights_that_old_models_list_as_inputs_are_no_images(network):
    inputs = [tensor("left", *IMAGE), tensor("kernel", 3, 3), tensor("right", *IMAGE)]
    inputs, outputs = read_graph(network(model([SUM], inputs, [tensor("out", *MAP)], weights=["kernel"])))
    assert [part.name for part in inputs] == ["left", "right"]
    assert inputs[0].shape == (1, 3, None, None)
    assert outputs[0].shape == (1, 1, None, None)


@given(st.data())
def test_a_damaged_model_is_read_or_refused(tmp_path_factory, data):
    content = bytearray(difference())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "damaged.onnx"
    path.write_bytes(content)
    try:
        found, _ = read_graph(path)
    except CamcalError as error:
        found = error.where
    assert found == str(path) or all(isinstance(part.name, str) for part in found)
