"""The shape of the package: who may import whom, and which modules touch OpenCV, plots, threads and processes.

Every rule first meets a planted violation, to show that it can fail. Only import statements are seen, wherever they
stand; importlib is not.
"""

import ast
import gc
from functools import cache
from pathlib import Path

import pytest

import camcal

PACKAGE = Path(camcal.__file__).parent

# From left to right; packages that share a place may not import each other.
LAYERS = (
    {
        "errors",
        "messages",
        "arrays",
        "dataclass",
        "records",
        "parsing",
        "options",
        "progress",
        "system",
        "files",
        "opencv",
    }
    | {"urls"},
    {"geometry", "solve", "optics"},
    {"cameras"},
    {"images", "targets", "estimate"},
    {"raw"},
    {"stereo", "calibrate", "simulate"},
    {"quality"},
    {"formats"},
    {"report"},
    {"run"},
    {"tasks"},
    {"cli"},
    {"__main__"},
)
PLACE = {name: place for place, names in enumerate(LAYERS) for name in names}
BASE = LAYERS[0]
MAY_USE_SIMULATE = {"tasks"}

OPENCV_EDGES = {
    "formats/disparity.py",
    "images/bag.py",
    "images/files.py",
    "images/video.py",
    "images/remap.py",
    "opencv.py",
    "raw/filters.py",
    "raw/tiles.py",
    "report/cloud_pictures.py",
    "report/colour_scale.py",
    "report/stereo_pictures.py",
    "report/overlays.py",
    "report/page/thumbnails.py",
    "run/process.py",
    "stereo/matching/matchers.py",
    "stereo/matching/learned.py",
    "stereo/matching/match.py",
    "stereo/matching/preparation.py",
    "stereo/matching/semi_global.py",
    "stereo/alignment.py",
    "stereo/coarse.py",
    "stereo/cloud.py",
    "targets/tag_lattice.py",
    "targets/ellipses.py",
    "targets/markers.py",
    "targets/page.py",
    "tasks/doctor.py",
}
CONCURRENCY = {"_thread", "asyncio", "concurrent", "multiprocessing", "subprocess", "threading"}
WEAK_NAMES = {"common", "helper", "helpers", "manager", "managers", "misc", "util", "utils"}
MAX_LINES = 400


def modules(package: Path) -> list[tuple[str, ast.Module]]:
    gc.disable()  # it would search all trees again and again, which takes three times as long as parsing
    try:
        return [(path.relative_to(package).as_posix(), parsed(path)) for path in sorted(package.rglob("*.py"))]
    finally:
        gc.enable()


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imported(module: str, tree: ast.Module) -> tuple[tuple[int, str], ...]:
    """Return the line and the dotted name of everything a module imports, `from a import b` as a.b."""
    parents, found = ["camcal", *module.split("/")[:-1]], []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = parents[: len(parents) - node.level + 1] if node.level else []
            prefix = ".".join([*base, *([node.module] if node.module else [])])
            found += [(node.lineno, f"{prefix}.{alias.name}") for alias in node.names]
    return tuple(found)


def room(module: str) -> str:
    """Return the package, or the module at the top, that a path or a dotted name below camcal belongs to."""
    return module.split("/", maxsplit=1)[0].removesuffix(".py")


def upward_imports(package: Path) -> list[str]:
    return [
        f"{module}:{line} {room(module)} -> {target}"
        for module, tree in modules(package)
        for line, name in imported(module, tree)
        if (target := target_of(name)) and not allowed(room(module), target)
    ]


def target_of(name: str) -> str | None:
    top, *rest = name.split(".")
    return rest[0] if top == "camcal" and rest and rest[0] in PLACE else None


def allowed(source: str, target: str) -> bool:
    if source in (target, "__init__") or (source in BASE and target in BASE):
        return True
    if target == "simulate" and source not in MAY_USE_SIMULATE:
        return False
    return PLACE[target] < PLACE[source]


def imports_of(package: Path, names: set[str]) -> set[str]:
    """Return the modules that import any of some top-level packages."""
    return {
        module for module, tree in modules(package) for _, name in imported(module, tree) if name.split(".")[0] in names
    }


@pytest.fixture
def plant(tmp_path):
    def plant(module: str, text: str) -> Path:
        path = tmp_path / module
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return tmp_path

    return plant


@pytest.mark.parametrize(
    ("module", "text", "found"),
    [
        ("geometry/pose.py", "from camcal.cli.main import app", "geometry/pose.py:1 geometry -> cli"),
        (
            "geometry/pose.py",
            "import numpy\ndef f():\n    import camcal.run.fanout",
            "geometry/pose.py:3 geometry -> run",
        ),
        ("images/files.py", "from camcal import targets", "images/files.py:1 images -> targets"),
        ("images/files.py", "from ..targets import board", "images/files.py:1 images -> targets"),
        ("solve/steps.py", "from camcal.geometry import pose", "solve/steps.py:1 solve -> geometry"),
        ("quality/gates.py", "from camcal.simulate import scene", "quality/gates.py:1 quality -> simulate"),
        ("files.py", "from camcal.geometry import pose", "files.py:1 files -> geometry"),
    ],
)
def test_a_package_imports_only_what_stands_to_its_left(plant, module, text, found):
    assert upward_imports(plant(module, text)) == [found]
    assert upward_imports(PACKAGE) == []


def test_what_stands_to_the_left_may_be_imported(plant):
    plant("tasks/calibration/demo.py", "from camcal.simulate import scene\nfrom camcal import __version__, arrays")
    plant("files.py", "from camcal.errors import FileError")
    assert upward_imports(plant("simulate/scene.py", "from . import render\nfrom camcal.targets import board")) == []


def test_every_package_and_module_at_the_top_has_its_place(plant):
    assert strangers(plant("plugins/pose.py", "")) == {"plugins"}
    assert strangers(PACKAGE) == set()


def strangers(package: Path) -> set[str]:
    return {room(module) for module, _ in modules(package)} - set(PLACE) - {"__init__"}


def test_threads_and_processes_start_in_the_fan_out_only(plant):
    assert imports_of(plant("tasks/run.py", "from concurrent.futures import Future"), CONCURRENCY) == {"tasks/run.py"}
    locks = {"files.py"}  # which starts none of its own
    assert imports_of(PACKAGE, CONCURRENCY) - locks == {
        *("run/cluster_worker.py", "run/fanout.py", "run/workers.py"),
        "run/process.py",  # one that waits for signals which the main thread does not hear
    }
    used = {name for _, name in imported("files.py", parsed(PACKAGE / "files.py"))}
    assert {name for name in used if name.split(".")[0] in CONCURRENCY} == {"threading.Lock"}


def test_no_modules_import_each_other_in_a_circle(plant):
    plant("images/load.py", "from camcal.images.save import save")
    plant("images/video.py", "from camcal.images import load")
    assert circular(plant("images/save.py", "def save():\n    from camcal.images import load")) == [
        "images/load.py",
        "images/save.py",
        "images/video.py",
    ]
    assert circular(PACKAGE) == []


def circular(package: Path) -> list[str]:
    """Return the modules in circles of imports, and those that need them; imports inside functions count."""
    trees = dict(modules(package))
    files = {f"camcal.{name.removesuffix('.py').replace('/', '.')}".removesuffix(".__init__"): name for name in trees}
    needs = {
        module: {files.get(name) or files.get(name.rpartition(".")[0]) for _, name in imported(module, tree)} - {module}
        for module, tree in trees.items()
    }
    while free := [module for module, targets in needs.items() if not targets & needs.keys()]:
        for module in free:
            del needs[module]
    return sorted(needs)


@pytest.mark.slow
def test_only_reports_import_a_plotting_library(plant):
    assert imports_of(plant("quality/plot.py", "import matplotlib.pyplot as plt"), {"matplotlib"}) == {
        "quality/plot.py"
    }
    assert {room(module) for module in imports_of(PACKAGE, {"matplotlib"})} <= {"report"}


def test_opencv_is_imported_at_the_edges_only(plant):
    assert imports_of(plant("solve/steps.py", "def f():\n    import cv2"), {"cv2"}) == {"solve/steps.py"}
    assert imports_of(PACKAGE, {"cv2"}) <= OPENCV_EDGES


def test_no_module_is_named_for_nothing(plant):
    assert weakly_named(plant("images/utils.py", "")) == ["images/utils.py"]
    assert weakly_named(PACKAGE) == []


def weakly_named(package: Path) -> list[str]:
    return [module for module, _ in modules(package) if WEAK_NAMES & set(module.removesuffix(".py").split("/"))]


def test_no_module_is_longer_than_a_reader_can_hold(plant):
    assert too_long(plant("images/files.py", "x = 1\n" * (MAX_LINES + 1))) == ["images/files.py"]
    assert too_long(PACKAGE) == []


def too_long(package: Path) -> list[str]:
    return [
        module
        for module, _ in modules(package)
        if len((package / module).read_text(encoding="utf-8").splitlines()) > MAX_LINES
    ]
