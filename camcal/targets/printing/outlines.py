"""The outlines of the black of a drawing: one path around squares that share a side, so that no seam shows there."""

from collections.abc import Iterator

import numpy as np

from camcal.arrays import Array

# Right, down, left, up: (column, row) of a step, in the order of turns to the right
_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
_TURNS = (1, 0, 3)  # to the right first: squares that only touch at a corner stay apart

Edge = tuple[int, int, int]  # where it starts (column, row of the line), and which of the steps it takes


def outlines(x: Array, y: Array, black: Array) -> tuple[Array, ...]:
    """Return the outlines (K, 2) of cells that are black, clockwise (y down) around them, holes the other way.

    x (M,), y (N,): the lines between cells, ascending. black: (N - 1, M - 1) of bool.
    """
    lattice = [np.array(corners) for corners in _loops(set(_edges(black)))]
    return tuple(np.column_stack([x[corners[:, 0]], y[corners[:, 1]]]) for corners in lattice)


def _edges(black: Array) -> Iterator[Edge]:
    """Yield the sides of black cells towards white, each with black to its right."""
    padded = np.pad(black, 1)
    inside = padded[1:-1, 1:-1]
    beside = (padded[:-2, 1:-1], padded[1:-1, 2:], padded[2:, 1:-1], padded[1:-1, :-2])  # above, right, below, left
    starts = ((0, 0), (1, 0), (1, 1), (0, 1))
    for step, (neighbour, (column, row)) in enumerate(zip(beside, starts, strict=True)):
        for place in np.argwhere(inside & ~neighbour).tolist():
            yield place[1] + column, place[0] + row, step


def _loops(edges: set[Edge]) -> Iterator[list[tuple[int, int]]]:
    """Yield the corners of every closed path along edges, and use them up; the order is that of the places."""
    for first in sorted(edges):
        if first in edges:
            yield _walk(first, edges)


def _walk(first: Edge, edges: set[Edge]) -> list[tuple[int, int]]:
    corners: list[tuple[int, int]] = []
    edge = first
    while True:
        edges.discard(edge)
        step = edge[2]
        column, row = edge[0] + _STEPS[step][0], edge[1] + _STEPS[step][1]
        onward = ((column, row, (step + turn) % 4) for turn in _TURNS)
        edge = next(way for way in onward if way == first or way in edges)
        if edge[2] != step:
            corners.append((column, row))
        if edge == first:
            return corners
