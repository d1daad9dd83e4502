"""Clouds to be written."""

import numpy as np
import pytest

from camcal.stereo.depth import COLOUR, NORMAL, POSITION, VertexStream, vertex_type


@pytest.fixture(scope="session")
def vertices():
    """A function that returns vertices (count,) with what is named: colour, intensity, normals, sigma."""

    def vertices(count, **has):
        rng = np.random.default_rng(count)
        found = np.zeros(count, vertex_type(**has))
        for name in POSITION:
            found[name] = rng.normal(0, 30, count)
        if has.get("colour"):
            for name in COLOUR:
                found[name] = rng.integers(0, 256, count)
        if has.get("normals"):
            directions = rng.normal(size=(3, count))
            for name, values in zip(NORMAL, directions / np.linalg.norm(directions, axis=0), strict=True):
                found[name] = values
        for name in {"intensity", "sigma"} & has.keys():
            if has[name]:
                found[name] = rng.random(count)
        return found

    return vertices


@pytest.fixture(scope="session")
def stream():
    """A function that returns vertices on their way to a file, in blocks of seven."""

    def stream(vertices, **words):
        blocks = [vertices[start : start + 7] for start in range(0, len(vertices), 7)]
        return VertexStream(len(vertices), vertices.dtype, blocks, **words)

    return stream
