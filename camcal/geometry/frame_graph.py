"""Named frames connected by transforms: paths, loop closure errors, expressions of products; links between cameras.

A product such as "a_T_b * inv(c_T_b)" is read without running it, and its frames are checked.
"""

import ast
import heapq
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from functools import reduce

import numpy as np

from camcal.arrays import FloatArray
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import JOINT, Derived, NamedTransform, Pose, frames_of
from camcal.parsing import did_you_mean, nearest

EXACT = 1e-9  # m and rad: the standard deviation of what is said to have none
ALIKE = 0.6  # how alike two names must be, up to 1, for one to be offered in the place of the other
MAX_LENGTH = 2000  # characters; keeps the depth of brackets within what can be followed


@dataclass(frozen=True)
class Link:
    """One transform on a way: its place among all, and whether it is gone through against its name."""

    index: int
    inverted: bool


_Tree = dict[str, tuple[Link, str] | None]  # frame: the link that leads to it, and the frame this comes from


@dataclass(frozen=True, eq=False)
class Loop:
    """Transforms that lead back to where they begin, and what is left over: the identity if all were exact.

    names: such as 'a_T_b' and 'inv(c_T_b)'. residual: a_T_a. covariance: (6, 6) of its step, None unless all the
    transforms have one.
    """

    names: tuple[str, ...]
    residual: Pose
    covariance: FloatArray | None

    @property
    def offset(self) -> float:
        """How far the loop is from closing, m."""
        return float(np.linalg.norm(self.residual.translation))

    @property
    def angle(self) -> float:
        """How far the loop is turned, rad."""
        return float(so3.angle_between(np.eye(3), self.residual.rotation))

    @property
    def chi_square(self) -> float | None:
        """The squared residual in standard deviations, of 6 degrees of freedom; None without covariances."""
        if self.covariance is None:
            return None
        step = np.concatenate([self.residual.translation, self.residual.vector()])
        variances, directions = np.linalg.eigh(self.covariance)
        return float(np.sum((directions.T @ step) ** 2 / np.maximum(variances, EXACT**2)))


class FrameGraph:
    """Transforms, several of them between the same two frames if need be, as the edges of a graph of frames."""

    def __init__(self, transforms: Iterable[NamedTransform]) -> None:
        self.transforms = tuple(transforms)
        self._names = Counter(transform.name for transform in self.transforms)
        self._links: dict[str, list[tuple[Link, str]]] = {}
        for index, transform in enumerate(self.transforms):
            self._links.setdefault(transform.target, []).append((Link(index, inverted=False), transform.source))
            self._links.setdefault(transform.source, []).append((Link(index, inverted=True), transform.target))

    @property
    def frames(self) -> tuple[str, ...]:
        """The names of all frames, in the order in which they occur."""
        return tuple(self._links)

    def path(self, target: str, source: str) -> tuple[Link, ...]:
        """Return the links that multiply to target_T_source: the fewest, of equally few those that are named first.

        Raises InvalidInput for a frame that is not there, and where no transforms join the two.
        """
        for frame in (target, source):
            self._require(frame)
        tree = self._tree(target)
        if source not in tree:
            raise InvalidInput(self._why_apart(target, source))
        return _way(tree, source)

    def along(self, links: Sequence[Link]) -> Derived[int]:
        """Return the product of links in their order, by the indices of their transforms."""
        factors = [self._factor(link) for link in links]
        return reduce(lambda left, right: left @ right, factors, Derived(Pose.identity(), {}))

    def name_of(self, link: Link) -> str:
        """Return a link as one writes it, a_T_b or inv(a_T_b), and where it stands if others have its name."""
        transform = self.transforms[link.index]
        alone = self._names[transform.name] == 1 or not transform.where
        name = transform.name if alone else f"{transform.name} of {transform.where}"
        return f"inv({name})" if link.inverted else name

    def loops(self, frame: str) -> list[Loop]:
        """Return one loop for every transform, of those joined with a frame, that is not needed to reach another."""
        tree = self._tree(frame)
        needed = {step[0].index for step in tree.values() if step is not None}
        return [
            self._loop(tree, index)
            for index, transform in enumerate(self.transforms)
            if index not in needed and transform.target in tree
        ]

    def _tree(self, start: str) -> _Tree:
        """Return the last step of the way from a frame to every other that can be reached, breadth first."""
        tree: _Tree = {start: None}
        ahead = deque([start])
        while ahead:
            here = ahead.popleft()
            for link, there in self._links[here]:
                if there not in tree:
                    tree[there] = (link, here)
                    ahead.append(there)
        return tree

    def _loop(self, tree: _Tree, index: int) -> Loop:
        """Return the loop that a transform a_T_b closes: from where the ways to a and b part, along one and back."""
        closing = self.transforms[index]
        there, back = _way(tree, closing.target), _way(tree, closing.source)
        shared = next((n for n, pair in enumerate(zip(there, back, strict=False)) if pair[0] != pair[1]), None)
        shared = min(len(there), len(back)) if shared is None else shared
        returning = [Link(link.index, not link.inverted) for link in reversed(back[shared:])]
        links = [*there[shared:], Link(index, inverted=False), *returning]
        derived = self.along(links)
        known = {link.index: self.transforms[link.index] for link in links}
        uncertain = all(item.covariance is not None for item in known.values())
        covariance = derived.covariance_of(known) if uncertain else None
        return Loop(tuple(self.name_of(link) for link in links), derived.pose, covariance)

    def _factor(self, link: Link) -> Derived[int]:
        factor = Derived.of(link.index, self.transforms[link.index].pose)
        return factor.inverse() if link.inverted else factor

    def _require(self, frame: str) -> None:
        if frame not in self._links:
            near = nearest(frame, self.frames, ALIKE)
            advice = f". Did you mean {near!r}?" if near else f"; there are {', '.join(self.frames) or 'none'}"
            raise InvalidInput(f"no frame {frame!r}{advice}")

    def _why_apart(self, target: str, source: str) -> str:
        here, there = list(self._tree(target)), list(self._tree(source))
        sides = f"one is with {', '.join(here)}, the other with {', '.join(there)}"
        text = f"no transforms join {target!r} and {source!r}: {sides}"
        alike = next(((name, near) for name in here if (near := nearest(name, there, ALIKE))), None)
        return f"{text}. Are {alike[0]!r} and {alike[1]!r} the same frame?" if alike else text


def _way(tree: _Tree, frame: str) -> tuple[Link, ...]:
    """Return the links from the root of a tree to a frame."""
    links = []
    while (step := tree[frame]) is not None:
        link, frame = step
        links.append(link)
    return tuple(reversed(links))


@dataclass(frozen=True, eq=False)
class FrameProduct:
    """A derived transform, the frames it joins, and how it was written."""

    target: str
    source: str
    derived: Derived[str]
    text: str

    @property
    def name(self) -> str:
        """The name a_T_b."""
        return f"{self.target}{JOINT}{self.source}"


def evaluate(text: str, transforms: Mapping[str, NamedTransform]) -> FrameProduct:
    """Return the product that a text describes: names a_T_b, * or @ between them, inv(), brackets.

    Raises InvalidInput for anything else, for a name that is not there, and where inner frames do not cancel.
    """
    if len(text) > MAX_LENGTH:
        raise InvalidInput(f"an expression of {len(text)} characters; at most {MAX_LENGTH} are read")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InvalidInput(f"{text[:60]!r} is not an expression such as 'a_T_b * inv(c_T_b)'") from error
    try:
        return _value(tree.body, transforms)
    except RecursionError as error:
        raise InvalidInput("too many nested parentheses") from error


def _value(node: ast.expr, transforms: Mapping[str, NamedTransform]) -> FrameProduct:
    match node:
        case ast.Name(id=name):
            if name not in transforms:
                raise InvalidInput(f"no transform {name!r}{_suggestion(name, transforms)}")
            found = transforms[name]
            return FrameProduct(found.target, found.source, Derived.of(name, found.pose), name)
        case ast.BinOp(left=left, op=ast.Mult() | ast.MatMult(), right=right):
            return _product(_value(left, transforms), _value(right, transforms))
        case ast.Call(func=ast.Name(id="inv"), args=[inner], keywords=[]):
            value = _value(inner, transforms)
            return FrameProduct(value.source, value.target, value.derived.inverse(), f"inv({value.text})")
        case _:
            raise InvalidInput(f"{ast.unparse(node)!r} is not supported: use names a_T_b, *, inv() and parentheses")


def _suggestion(name: str, transforms: Mapping[str, NamedTransform]) -> str:
    known = list(transforms)
    if JOINT in name:
        target, source = frames_of(name)
        if (reverse := f"{source}{JOINT}{target}") in transforms:
            return f"; write inv({reverse})"
    return did_you_mean(name, known, f"; there are {', '.join(known) or 'none'}")


def _product(left: FrameProduct, right: FrameProduct) -> FrameProduct:
    product = f"{left.text} * {right.text}"
    if left.source != right.target:
        hint = f": they are {left.name} and {right.name}"
        if left.source == right.source:
            hint = f"; did you mean {left.text} * inv({right.text})?"
        elif left.target == right.target:
            hint = f"; did you mean inv({left.text}) * {right.text}?"
        raise InvalidInput(f"{product}: {left.source!r} does not meet {right.target!r}{hint}")
    return FrameProduct(left.target, right.source, left.derived @ right.derived, product)


@dataclass(frozen=True)
class CameraLink:
    """Two cameras, the boards that they saw in the same captures (one name where it is the same, none where it has
    none), how many captures, and the standard deviation, m, of an axis of their relative position by these alone.
    """

    cameras: tuple[str, str]
    boards: tuple[str, ...]
    captures: int
    std: float

    def as_data(self) -> dict[str, object]:
        """Return the link as plain data."""
        return {
            "cameras": list(self.cameras),
            "boards": list(self.boards),
            "captures": self.captures,
            "std_m": self.std,
        }


def certain_path(links: Sequence[CameraLink], first: str, last: str) -> tuple[CameraLink, ...]:
    """Return the links that lead from one camera to another with the least variance, none where nothing does.

    Source: Dijkstra, A note on two problems in connexion with graphs, 1959.
    """
    beside: dict[str, list[CameraLink]] = {}
    for link in links:
        for camera in link.cameras:
            beside.setdefault(camera, []).append(link)
    reached: dict[str, tuple[CameraLink, ...]] = {}
    open_: list[tuple[float, int, str, tuple[CameraLink, ...]]] = [(0.0, 0, first, ())]
    count = 0
    while open_:
        variance, _, camera, path = heapq.heappop(open_)
        if camera in reached:
            continue
        reached[camera] = path
        for link in beside.get(camera, ()):
            [other] = set(link.cameras) - {camera}
            count += 1
            heapq.heappush(open_, (variance + link.std**2, count, other, (*path, link)))
    return reached.get(last, ())
