"""A campaign on a real Dask scheduler with two workers, offline on this machine."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pyarrow.parquet as pq
import pytest

import bench
from bench.cli.verbs import guide
from bench.core.records.specs import EstimatorChoice
from bench.core.words.exceptions import ConfigError, WorkersLostError
from bench.experiments.campaigns import cluster
from bench.experiments.campaigns.journal import NAME
from bench.experiments.campaigns.pools import SerialExecutor
from tests.campaigns.test_campaign import PROFILE

distributed = pytest.importorskip("distributed", reason="pip install dask distributed")
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")

OWN = """import sys
if "distributed" in sys.modules:
    raise SystemExit("imported in a worker")
from bench.navigation.models.loose_tight import Loose as Own
"""


@contextlib.contextmanager
def start(
    place: Path, count: int, more: Mapping[str, str] | None = None
) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Start a scheduler, the first process, and workers that cannot import what is in the present folder."""
    address = place / "address.json"
    common = ["--scheduler-file", str(address), "--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
    commands = [["scheduler", "--host", "127.0.0.1", "--port", "0", *common]]
    worker = ["worker", "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny", "--death-timeout", "60"]
    commands += [[*worker, "--local-directory", str(place), *common] for _ in range(count)]
    environment = os.environ | {"DASK_DISTRIBUTED__SCHEDULER__WORKER_SATURATION": "1"} | dict(more or {})
    environment["PYTHONPATH"] = str(Path(bench.__file__).parents[1])
    with contextlib.ExitStack() as stack:
        started = []
        for name, *arguments in commands:
            main = [sys.executable, "-m", f"distributed.cli.dask_{name}", *arguments]
            process = subprocess.Popen(main, env=environment, cwd=place, stderr=subprocess.DEVNULL)
            stack.callback(process.wait)
            stack.callback(process.kill)
            started.append(process)
        deadline = time.monotonic() + 60.0
        while not address.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        found = json.loads(address.read_text())["address"]
        with distributed.Client(found, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=60 + 5 * count)
        yield found, started


def test_a_cluster_that_loses_a_worker_gives_every_result(tmp_path, monkeypatch):
    """The filter is shipped; workers with other versions are rejected."""
    (tmp_path / "short.toml").write_text(PROFILE)
    (tmp_path / "shipped.py").write_text(OWN)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    options: dict[str, Any] = {"estimators": ["shipped:Own"]}
    with start(tmp_path / "elsewhere", 2) as (address, processes):
        with monkeypatch.context() as patch:
            patch.setattr(cluster, "describe_software", lambda: {"bench": "0.0.0"})
            with pytest.raises(ConfigError, match=r"bench .*, here 0\.0\.0; equal versions are needed"):
                bench.campaign("short.toml", 6, scheduler=address, out="refused", **options)

        def lose(progress: Any) -> None:
            if progress.new == 2:
                processes[1].kill()

        result = bench.campaign("short.toml", 6, scheduler=address, out="spread", progress=lose, **options)
        assert processes[1].poll() is not None
    assert (result.finished, result.failed) == (6, {})
    bench.campaign("short.toml", 6, executor=SerialExecutor(), out="here", **options)
    assert (tmp_path / "spread/runs.parquet").read_bytes() == (tmp_path / "here/runs.parquet").read_bytes()
    assert pq.read_table("here/runs.parquet").num_rows == 6


@pytest.mark.long
def test_a_scheduler_that_ends_costs_nothing_that_is_finished(tmp_path, monkeypatch):
    (tmp_path / "short.toml").write_text(PROFILE)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    with start(tmp_path / "elsewhere", 1) as (address, processes):

        def lose(progress: Any) -> None:
            if progress.new == 2:
                processes[0].kill()

        with pytest.raises(
            WorkersLostError, match=r"the Dask scheduler does not respond: .*--resume continues$"
        ):
            bench.campaign("short.toml", 40, scheduler=address, out="spread", progress=lose)
    done = len((tmp_path / "spread" / NAME).read_bytes().splitlines())
    assert 2 <= done < 40
    result = bench.campaign("short.toml", 40, executor=SerialExecutor(), out="spread", resume=True)
    assert (result.finished, result.failed) == (40, {})


@pytest.mark.long
def test_twenty_workers_lose_one_of_them_and_then_the_scheduler(tmp_path, monkeypatch):
    """Afterwards a campaign without workers goes on, to the same bits as one without either loss."""
    (tmp_path / "short.toml").write_text(PROFILE)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    options: dict[str, Any] = {"estimators": ["loose-15"]}
    sent: list[Any] = []
    read = cluster.results.read_truth
    monkeypatch.setattr(cluster.results, "read_truth", lambda key: sent.append(key) or read(key))
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path / "driver"))
    with start(tmp_path / "elsewhere", 20, {"BENCH_CACHE": str(tmp_path / "workers")}) as (
        address,
        processes,
    ):

        def lose(progress: Any) -> None:
            if progress.new == 5:
                processes[7].kill()
            elif progress.new == 60:
                processes[0].kill()

        with pytest.raises(WorkersLostError, match="the Dask scheduler does not respond"):
            bench.campaign("short.toml", 400, scheduler=address, out="spread", progress=lose, **options)
    assert len(sent) == 1  # the cache of the twenty gets the truth once
    result = bench.campaign(
        "short.toml", 400, executor=SerialExecutor(), out="spread", resume=True, **options
    )
    assert (result.finished, result.failed) == (400, {})
    bench.campaign("short.toml", 400, executor=SerialExecutor(), out="here", **options)
    for name in ("runs.parquet", "epochs.parquet"):
        assert (tmp_path / "spread" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


def test_the_end_of_the_scheduler_is_told_wherever_it_shows(monkeypatch):
    closed = distributed.comm.CommClosedError

    def fail(*_: Any, **__: Any) -> None:
        raise closed("ConnectionPool closing.")

    executor = SimpleNamespace(submit=fail)
    client = SimpleNamespace(nthreads=fail, status="running", get_executor=lambda **_: executor)
    client.run = lambda _: {"w": cluster.describe_software()}
    monkeypatch.setattr(distributed, "Client", lambda *_, **__: client)
    pool = cluster.ClusterPool("tcp://x:1", [])
    client.run = fail
    for ask in (
        lambda: pool.workers,
        pool.check,
        pool.recover,
        lambda: pool.submit(int),
        lambda: pool.share(["k"]),
    ):
        with pytest.raises(WorkersLostError) as caught:
            ask()
        assert str(caught.value) == (
            "tcp://x:1: the Dask scheduler does not respond: ConnectionPool closing.; "
            "what is finished is kept, --resume continues"
        )

    def raise_own(*_: Any) -> None:
        raise ValueError("no scheduler's fault")

    executor.submit = raise_own
    with pytest.raises(ValueError, match="fault"):
        pool.submit(int)


def find_guide_lines(port: int) -> list[str]:
    """Return the scripts of the guide that start a scheduler and workers, on this machine and a free port."""
    text = (guide.FOLDER / "cluster.md").read_text(encoding="utf-8")
    scripts = []
    for block in re.findall(r"^```text\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        if "dask scheduler" in block:
            started = re.sub(r"^(?!.*dask|export |local=).*\n", "", block, flags=re.MULTILINE)
            here = re.sub(r"10\.0\.0\.\d", "127.0.0.1", started.replace("8787", "0"))
            one_port = re.sub(r"dask scheduler( --port 8786)?", "dask scheduler --port 8786", here)
            behind = re.sub(r"^(dask .*?)( &)?$", r"\1 &", one_port, flags=re.MULTILINE)
            scripts.append(behind.replace("8786", str(port)).replace("--nworkers 8", "--nworkers 2"))
    return scripts


@pytest.mark.skipif(sys.platform != "linux", reason="the lines of the guide are those of a POSIX shell")
@pytest.mark.parametrize("number", [0, 1], ids=["many machines", "one machine"])
def test_the_lines_of_the_guide_listen_only_where_they_say(tmp_path, number):
    """What listens takes pickles, so that it must not listen at all addresses of a machine."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    script = find_guide_lines(port)[number]
    assert script.count("dask worker") == number + 1
    shell = subprocess.Popen(
        ["/bin/sh", "-c", f"{script}wait"],
        cwd=tmp_path,
        env={**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"},
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        with distributed.Client(f"tcp://127.0.0.1:{port}", timeout=60, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
            started = psutil.Process(shell.pid).children(recursive=True)
            listening = {
                connection.laddr
                for one in started
                for connection in (
                    one.net_connections if hasattr(one, "net_connections") else one.connections
                )()
                if connection.status == psutil.CONN_LISTEN
            }
    finally:
        os.killpg(shell.pid, signal.SIGKILL)
        shell.wait()
    assert {address.ip for address in listening} == {"127.0.0.1"}
    assert port in {address.port for address in listening}
    assert len(listening) >= 6  # each of the three processes has one for the others and one for its page


def test_a_package_is_sent_whole_and_workers_that_differ_or_are_gone_are_told(tmp_path, monkeypatch):
    own = tmp_path / "own_filters"
    (own / "deep").mkdir(parents=True)
    for name in ("__init__.py", "one.py", "deep/two.py"):
        (own / name).write_text("x = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    sent: list[list[str]] = []
    client = SimpleNamespace(
        upload_file=lambda path, load: sent.append(sorted(zipfile.ZipFile(path).namelist())),
        nthreads=lambda: threads, get_executor=lambda **_: None,
        run=lambda _: {"w": cluster.describe_software()},
    )  # fmt: skip
    monkeypatch.setattr(distributed, "Client", lambda *_, **__: client)
    monkeypatch.setattr(cluster, "time", SimpleNamespace(monotonic=lambda: now))
    now, threads = 0.0, {"a": 2}
    pool = cluster.ClusterPool("tcp", [EstimatorChoice("own_filters.one:Own", "own")])
    assert sent == [[f"own_filters/{name}" for name in ("__init__.py", "deep/two.py", "one.py")]]

    now = 1000.0
    pool.check()
    now, threads = 1119.0, {}
    pool.check()
    now = 1121.0
    with pytest.raises(WorkersLostError, match="no worker for 120 s"):
        pool.check()
    with pytest.raises(ConfigError, match="its versions differ from the driver"):
        cluster.call({"bench": "another"}, int)


def test_a_scheduler_that_does_not_answer_is_told(tmp_path, monkeypatch):
    (tmp_path / "short.toml").write_text(PROFILE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cluster, "CONNECT_TIME", 0.2)
    with pytest.raises(ConfigError, match="no Dask scheduler answers"):
        bench.campaign("short.toml", 2, scheduler="tcp://127.0.0.1:9")
