"""The tests run in any order: none draws from a generator that others draw from too."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
GENERATORS = {"default_rng", "Generator", "Random", "RandomState"}
SHARED = {"class", "module", "package", "session"}


def shared_generators(source: str) -> Iterator[int]:
    """Return the lines where tests come to share a generator: as a constant, a default, or a fixture of many tests."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef):
            made = (line.value for line in node.body if isinstance(line, ast.Assign | ast.AnnAssign))
            yield from (value.lineno for value in made if is_generator(value))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from (value.lineno for value in (*node.args.defaults, *node.args.kw_defaults) if is_generator(value))
        if isinstance(node, ast.FunctionDef) and any(map(lives_on, node.decorator_list)):
            returned = [part.value for part in ast.walk(node) if isinstance(part, ast.Return | ast.Yield)]
            yield from (value.lineno for value in returned if is_generator(value))


def is_generator(value: ast.expr | None) -> bool:
    return isinstance(value, ast.Call) and ast.unparse(value.func).split(".")[-1] in GENERATORS


def lives_on(decorator: ast.expr) -> bool:
    if not isinstance(decorator, ast.Call):
        return ast.unparse(decorator).split(".")[-1] == "cache"
    scopes = [word.value for word in decorator.keywords if word.arg == "scope"]
    return any(isinstance(scope, ast.Constant) and scope.value in SHARED for scope in scopes)


@pytest.mark.parametrize(
    "planted",
    [
        "RNG = np.random.default_rng(1)",
        "rng: Generator = default_rng(1)",
        "class Test:\n    rng = random.Random(1)",
        "def noisy(values, rng=np.random.default_rng(1)):\n    return rng",
        "@pytest.fixture(scope='module')\ndef rng():\n    return np.random.default_rng(1)",
        "@cache\ndef rng():\n    return np.random.default_rng(1)",
    ],
)
def test_a_shared_generator_is_seen(planted):
    assert list(shared_generators(planted))


@pytest.mark.parametrize(
    "allowed",
    [
        "NOISE = np.random.default_rng(1).normal(size=3)",
        "def test_noise():\n    rng = np.random.default_rng(1)",
        "@pytest.fixture\ndef rng():\n    return np.random.default_rng(1)",
    ],
)
def test_a_generator_of_one_test_is_allowed(allowed):
    assert not list(shared_generators(allowed))


@pytest.mark.slow
def test_no_tests_share_a_generator():
    found = [
        f"{path.relative_to(TESTS)}:{line}"
        for path in sorted(TESTS.rglob("*.py"))
        for line in shared_generators(path.read_text())
    ]
    assert found == []
