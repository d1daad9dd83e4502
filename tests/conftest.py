"""What every test may use: the shared real data, and quick randomised searches."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

PROJECT = Path(__file__).parents[1]

settings.register_profile("camcal", max_examples=50, deadline=None, derandomize=True)
settings.load_profile("camcal")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Count every test of real data among the slow ones."""
    for item in items:
        if "real_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real images, CAMCAL_TEST_DATA or ../shared/data; the test is skipped where there is none."""
    folder = Path(os.environ.get("CAMCAL_TEST_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        message = f"no real data: {folder} is not a folder (set CAMCAL_TEST_DATA)"
        if os.environ.get("CAMCAL_REQUIRE_DATA"):
            pytest.fail(message)
        pytest.skip(message)
    return folder
