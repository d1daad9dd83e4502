"""Commands on a Dask cluster leave the same bytes as without it, from folders and from a server of objects."""

import gc
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from batch_scenes import BOARD, COMMANDS, RIG, SIMULATION, contents, draw_scene, recorded
from dask_cluster import dask_cluster, wait_until

CAMCAL = "import sys; from camcal.cli.main import main; sys.argv[0] = 'camcal'; main()"
MANY = 200

pytestmark = [  # of connections to clusters; Dask leaves their sockets to the collector
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A running cluster, in a folder that the commands find something to do in."""
    folder = tmp_path_factory.mktemp("cluster")
    draw_scene(folder)
    with dask_cluster(folder) as running:
        yield running
    gc.collect()


@pytest.fixture
def place(cluster, monkeypatch):
    """The cluster, in whose folder the test works; nothing has been written there."""
    monkeypatch.chdir(cluster.folder)
    shutil.rmtree("out", ignore_errors=True)
    return cluster


def camcal(*words, **environment):
    command = [sys.executable, "-c", CAMCAL, *map(str, words)]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_results_on_a_cluster_are_the_same_bytes(run, place, name):
    words = COMMANDS[name]
    if BOARD in words and not Path("views").exists():
        assert run(*SIMULATION)[0] == 0
    assert run(*words, "--jobs", 1)[0] == 0
    here = contents()
    shutil.rmtree("out")
    code, _, err = run(*words, "--scheduler", place.url)
    assert code == 0, err
    assert contents() == here


@pytest.mark.slow
@pytest.mark.parametrize("resume", [[], ["--resume"]], ids=["first run", "resumed run"])
def test_a_command_that_is_killed_while_a_cluster_works_for_it_is_resumed_to_the_same_bytes(
    run, start_python, place, resume
):
    Path("many").mkdir(exist_ok=True)
    for number in range(MANY):
        if not Path(f"many/{number}.png").exists():
            shutil.copy(f"images/{number % 12}.png", f"many/{number}.png")
    words = ("undistort", f"{RIG}#left", "many", "-o", "out")
    on_cluster = (*words, "--scheduler", place.url, "--resume")
    for least in (1, MANY // 3):
        process = start_python("-c", CAMCAL, *words, "--scheduler", place.url, *resume, stdout=subprocess.DEVNULL)
        wait_until(lambda least=least: recorded() >= least)
        process.kill()
        assert process.wait() == -signal.SIGKILL
        resume = ["--resume"]
    before = recorded()
    assert f"{before} of {MANY} images complete and unchanged" in camcal(*on_cluster)
    resumed = contents()
    shutil.rmtree("out")
    assert run(*words, "--jobs", 1)[0] == 0
    assert resumed == contents()


@pytest.mark.slow
def test_images_of_an_object_store_are_worked_on_by_a_cluster(run, place):
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
    camera = f"{RIG}#left"
    try:
        assert run("undistort", camera, "images", "-o", "out", "-q")[0] == 0
        with dask_cluster(place.folder, extra=environment) as running:
            script = "import s3fs; s = s3fs.S3FileSystem(); s.mkdir('lab'); s.put('images', 'lab/images', True)"
            subprocess.run([sys.executable, "-c", script], env=os.environ | environment, check=True)
            call = ("undistort", camera, "s3://lab/images", "-o", "s3://lab/out", "-q")
            camcal(*call, "--scheduler", running.url, **environment)
            camcal(*call, "--resume", **environment)
        script = "import s3fs; s3fs.S3FileSystem().get('lab/out', 'fetched', recursive=True)"
        subprocess.run([sys.executable, "-c", script], env=os.environ | environment, check=True)
    finally:
        server.stop()
    here, there = contents(), contents(Path("fetched"))
    for name in ("camera.yaml", ".camcal-output"):  # it names its sources, and the list has its hash
        assert here.pop(name) != there.pop(name)
    assert here == there
