"""The motion of a board as a cubic spline: nodes are poses, evenly spaced in time.

Translations are a uniform cubic B-spline of the nodes'. Rotations are one of the nodes' unit quaternions, divided by
its length: smooth to the second derivative as well, with derivatives in closed form. Nodes are moved as all poses are,
R ← Exp(δr) R. Quaternions are w x y z; adjacent nodes have the same sign.
Source: de Boor, A Practical Guide to Splines, 2001.
"""

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.geometry import rotation as so3
from camcal.solve.chains import WIDTH

# B-spline weights of the four nodes of a span by powers 1, u, u², u³ of the share u of the span
_BASIS = np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6.0
_ROUNDS = 6  # of reweighting
_SMOOTH = 1e-6  # of a pose's weight: holds nodes between poses
_MARGIN = 1.0  # spans before the first and after the last time


@dataclass(frozen=True, eq=False)
class Knots:
    """Evenly spaced knots: span k is the time from start + k · step on, of `spans` spans."""

    start: float
    step: float
    spans: int

    @classmethod
    def over(cls, first: float, last: float, step: float) -> "Knots":
        """Return the knots of spans of length `step` from before one time to after another, s."""
        return cls(first - _MARGIN * step, step, int(np.ceil((last - first) / step + 2 * _MARGIN)))

    @property
    def nodes(self) -> int:
        return self.spans + WIDTH - 1

    def places(self, times: Array) -> tuple[Array, Array]:
        """Return the span (M,) of times (M,) and the share of it that has passed; outside all spans below 0 or so."""
        passed = (times - self.start) / self.step
        spans = np.floor(passed).astype(np.intp)
        return spans, passed - spans

    def contain(self, times: Array) -> Array:
        """Return which times (M,) lie in spans."""
        passed = (times - self.start) / self.step
        return np.asarray((passed >= 0) & (passed < self.spans))

    def weights(self, shares: Array) -> tuple[Array, Array]:
        """Return the weights (4, M) of a span's nodes at shares (M,) of it, and their derivatives by time, 1/s."""
        powers = np.stack([np.ones_like(shares), shares, shares**2, shares**3])
        slopes = np.stack([np.zeros_like(shares), np.ones_like(shares), 2 * shares, 3 * shares**2]) / self.step
        return _BASIS @ powers, _BASIS @ slopes


@dataclass(frozen=True, eq=False)
class Moments:
    """Poses at M times, and how fast they change: quaternions (4, M), translations, velocities, turning (3, M), m, m/s
    and rad/s, R' = hat(turning) R.

    spans: (M,). by_node: (4, M) what a node's step moves the translation by. apart: (4, 4, M) w, x y z of each node:
    its turn δr turns the pose by w δr - v x δr.
    """

    quaternions: Array
    translations: Array
    velocities: Array
    turning: Array
    spans: Array
    by_node: Array
    apart: Array

    def turned(self, points: Array) -> Array:
        """Return points (3, M) of the board along the rig's axes."""
        w, v = self.quaternions[:1], self.quaternions[1:]
        twice = 2 * cross(v, points)
        return np.asarray(points + w * twice + cross(v, twice))

    def turned_back(self, vectors: Array) -> Array:
        """Return vectors (3, M) along the rig's axes along those of the board."""
        w, v = self.quaternions[:1], -self.quaternions[1:]
        twice = 2 * cross(v, vectors)
        return np.asarray(vectors + w * twice + cross(v, twice))

    def by_nodes(self, by_point: Array, turned: Array) -> Array:
        """Return derivatives (2, 24, M) by the nodes of each time's span.

        by_point: (2, 3, M), those by the points along the rig's axes, which are at `turned` (3, M) from the board's.
        """
        result = np.empty((2, WIDTH, 6, turned.shape[1]))
        for row, own in enumerate(by_point):
            arm = cross(turned, own)  # by the turn of the board
            for node in range(WIDTH):
                np.multiply(own, self.by_node[node], out=result[row, node, :3])
                w, v = self.apart[node, :1], self.apart[node, 1:]
                np.add(w * arm, cross(v, arm), out=result[row, node, 3:])
        return result.reshape(2, WIDTH * 6, -1)


@dataclass(frozen=True, eq=False)
class Motion:
    """A spline: quaternions (K, 4) and translations (K, 3) of its nodes."""

    knots: Knots
    quaternions: Array
    translations: Array

    def at(self, times: Array) -> Moments:
        """Return the poses at times (M,), all within the knots."""
        spans, shares = self.knots.places(times)
        weights, slopes = self.knots.weights(shares)
        rows = spans + np.arange(WIDTH)[:, None]
        own = [self.quaternions.T[:, row] for row in rows]
        nodes = [self.translations.T[:, row] for row in rows]
        mixed = sum(weight * each for weight, each in zip(weights, own, strict=True))
        length = np.sqrt(np.sum(mixed**2, axis=0))
        unit = np.asarray(mixed / length)
        change = sum(slope * each for slope, each in zip(slopes, own, strict=True))
        # of each node from the pose; the turn of Σ w q by the node's is w / |Σ w q| · vec((0, δ) ∘ apart)
        apart = [_from(each, unit) * (weight / length) for weight, each in zip(weights, own, strict=True)]
        return Moments(
            unit,
            np.asarray(sum(weight * each for weight, each in zip(weights, nodes, strict=True))),
            np.asarray(sum(slope * each for slope, each in zip(slopes, nodes, strict=True))),
            2 * _from(np.asarray(change), unit)[1:] / length,
            spans=spans,
            by_node=weights,
            apart=np.stack(apart),
        )

    def retract(self, step: Array) -> "Motion":
        """Return the spline with its nodes moved by steps (K, 6)."""
        angle = np.linalg.norm(step[:, 3:], axis=1, keepdims=True)
        turn = np.concatenate([np.cos(angle / 2), step[:, 3:] * np.sinc(angle / (2 * np.pi)) / 2], axis=1)
        return Motion(self.knots, so3.quaternion_product(turn, self.quaternions), self.translations + step[:, :3])

    def refined(self) -> "Motion":
        """Return the same motion, all but exactly, by spans half as long."""
        knots = Knots(self.knots.start, self.knots.step / 2, 2 * self.knots.spans)
        values = np.concatenate([self.translations, self.quaternions], axis=1)
        finer = np.empty((knots.nodes, 7))
        # Lane and Riesenfeld: the middles of adjacent nodes, and (1, 6, 1) / 8 of three
        finer[0::2] = (values[:-1] + values[1:])[: len(finer[0::2])] / 2
        finer[1::2] = ((values[:-2] + 6 * values[1:-1] + values[2:]) / 8)[: len(finer[1::2])]
        return Motion(knots, finer[:, 3:] / np.linalg.norm(finer[:, 3:], axis=1, keepdims=True), finer[:, :3])


def motion_through(knots: Knots, times: Array, rotations: Array, translations: Array) -> Motion:
    """Return the spline that is near most poses (N,), in order of time; a few may be anything."""
    from scipy.linalg import solveh_banded

    quaternions = _of_one_sign(so3.to_quaternion(rotations))
    values = np.concatenate([translations, quaternions], axis=1)
    spans, shares = knots.places(times)
    basis, _ = knots.weights(shares)
    smooth = np.array([1.0, -2.0, 1.0])
    reach = float(np.median(np.abs(translations - np.median(translations, axis=0)))) + 1e-9
    weights, found = np.ones(len(times)), np.zeros((knots.nodes, 7))
    for _ in range(_ROUNDS):
        band, right = np.zeros((WIDTH, knots.nodes)), np.zeros((knots.nodes, 7))
        for row in range(WIDTH):
            np.add.at(right, spans + row, (weights * basis[row])[:, None] * values)
            for column in range(row + 1):
                np.add.at(band[row - column], spans + column, weights * basis[row] * basis[column])
        for row in range(3):
            for column in range(row + 1):
                band[row - column, column : column + knots.nodes - 2] += _SMOOTH * smooth[row] * smooth[column]
        found = solveh_banded(band, right, lower=True, check_finite=False)
        left = values - np.einsum("nm,nmi->mi", basis, found[spans + np.arange(WIDTH)[:, None]])
        away = np.linalg.norm(left[:, :3], axis=1) / reach + np.linalg.norm(left[:, 3:], axis=1)
        weights = 1 / (1 + (away / (3 * float(np.median(away)) + 1e-12)) ** 2)
    lengths = np.linalg.norm(found[:, 3:], axis=1, keepdims=True)
    return Motion(knots, found[:, 3:] / lengths, found[:, :3])


def _of_one_sign(quaternions: Array) -> Array:
    """Return quaternions (N, 4) in order with the signs that make them smooth; single ones may be anything."""
    result, usual = quaternions.copy(), quaternions[0].copy()
    for row in range(len(result)):
        if result[row] @ usual < 0:
            result[row] *= -1
        usual = 0.6 * usual + 0.4 * result[row]
    return result


def _from(left: Array, right: Array) -> Array:
    """Return the products (4, M) of quaternions (4, M) with the conjugates of unit ones: the turns from these."""
    w, v, s, u = left[:1], left[1:], right[:1], right[1:]
    return np.concatenate([w * s + np.sum(v * u, axis=0, keepdims=True), s * v - w * u - cross(v, u)])


def cross(first: Array, second: Array) -> Array:
    """Return the cross products (3, M) of vectors (3, M)."""
    (a, b, c), (x, y, z) = first, second
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x])
