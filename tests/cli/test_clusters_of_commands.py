"""Commands on a Dask cluster leave the same bytes as without it, from folders and from a server of objects."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from dask_cluster import dask_cluster

CAMCAL = "import sys; from camcal.cli.main import main; sys.argv[0] = 'camcal'; main()"
CALLS = {
    "undistort": "undistort scene/truth.yaml scene/images -o {}",
    "detect": "detect scene/images -b scene/board.yaml -o {}/corners.csv",
    "pnp": "pnp scene/truth.yaml scene/images -b scene/board.yaml -o {}/poses.csv",
}


def camcal(*words, **environment):
    command = [sys.executable, "-c", CAMCAL, *map(str, words)]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def contents(folder):
    return {path.name: path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with rendered images, and a running cluster."""
    folder = tmp_path_factory.mktemp("cluster")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        camcal("simulate", "chessboard:9x6:25mm", "-o", "scene", "--views", 6, "--size", "640x480", "-q")
        with dask_cluster(folder) as running:
            yield running


@pytest.mark.slow
@pytest.mark.parametrize("name", ["undistort", "detect", "pnp"])
def test_results_on_a_cluster_are_the_same_bytes(place, name):
    words = CALLS[name]
    for output, extra in (("here", ()), ("there", ("--scheduler", place.url))):
        camcal(*words.format(f"{output}-{name}").split(), "-q", *extra)
    here, there = contents(f"here-{name}"), contents(f"there-{name}")
    assert here
    assert here == there


@pytest.mark.slow
def test_images_of_an_object_store_are_worked_on_by_a_cluster(place, monkeypatch):
    pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server").ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    environment = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    try:
        camcal("undistort", "scene/truth.yaml", "scene/images", "-o", "local", "-q")
        with dask_cluster(place.folder, extra=environment) as running:
            script = "import s3fs; s = s3fs.S3FileSystem(); s.mkdir('lab'); s.put('scene/images', 'lab/images', True)"
            subprocess.run([sys.executable, "-c", script], env=os.environ | environment, check=True)
            call = ("undistort", "scene/truth.yaml", "s3://lab/images", "-o", "s3://lab/out", "-q")
            camcal(*call, "--scheduler", running.url, **environment)
            camcal(*call, "--resume", **environment)
        script = "import s3fs; s3fs.S3FileSystem().get('lab/out', 'fetched', recursive=True)"
        subprocess.run([sys.executable, "-c", script], env=os.environ | environment, check=True)
    finally:
        server.stop()
    here, there = contents("local"), contents("fetched")
    for name in ("camera.yaml", ".camcal-output"):  # it names its sources, and the list has its hash
        assert here.pop(name) != there.pop(name)
    assert here == there
