"""Comparisons on a Dask cluster: real worker processes on this machine, one of them killed."""

import logging
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from compare_cases import cells, words, write_globe

import tuning.cli
from hapticlod.errors import InputError
from tuning.compare.cluster import TIMING, DaskWorkers
from tuning.compare.task import Stage, Task, perform

distributed = pytest.importorskip("distributed", reason="hapticlod[cluster] is not installed")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("cluster")
    write_globe(made / "a.stl")
    write_globe(made / "b.stl", 12.0)
    return made


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a scheduler with two worker processes; "timer" may time, and is started again when it dies."""
    common = {"nthreads": 1, "host": "127.0.0.1", "dashboard": False}
    workers = {
        "timer": {"cls": distributed.Nanny, "options": {**common, "resources": {TIMING: 1}}},
        "other": {"cls": distributed.Nanny, "options": common},
    }
    about = {"cls": distributed.Scheduler, "options": {"host": "127.0.0.1", "port": 0, "dashboard": False}}
    with distributed.SpecCluster(workers, about, silence_logs=logging.CRITICAL) as cluster:
        cluster.workers["other"].auto_restart = False  # one process less to start
        yield cluster.scheduler_address


def pid_of(client: Any, name: str) -> int:
    """Process of the worker with that name."""
    known = client.scheduler_info(n_workers=-1)["workers"]
    return client.run(os.getpid)[next(address for address, worker in known.items() if worker["name"] == name)]


def test_a_worker_that_is_killed_costs_no_result(folder: Path, scheduler: str) -> None:
    asked = cells(folder, "a.stl", "b.stl", configs=("fixed_finest", "velocity_ours", "fixed_coarse"))
    tasks = [Task(Stage.FEEL, cell) for cell in asked]
    found = {}
    with DaskWorkers(scheduler, 0) as workers, distributed.Client(scheduler, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        other = pid_of(client, "other")
        for task, outcome in workers.outcomes(tasks, alone=False):
            found[task.cell.names] = outcome
            if len(found) == 1:
                os.kill(other, signal.SIGKILL)  # what it was doing, and what it had not sent yet, is lost
        assert other not in client.run(os.getpid).values()
    assert len(found) == 6
    for cell in asked:
        assert found[cell.names].result == perform(Task(Stage.FEEL, cell)).result


def test_timing_goes_to_the_worker_that_is_marked_even_if_it_dies(folder: Path, scheduler: str) -> None:
    tasks = [Task(Stage.TIME, cell) for cell in cells(folder, "a.stl", "b.stl")]
    medians_us: list[float] = []
    with DaskWorkers(scheduler, 0) as workers, distributed.Client(scheduler, set_as_default=False) as client:
        timer = pid_of(client, "timer")
        for _, outcome in workers.outcomes(tasks, alone=True):
            medians_us.append(outcome.result["metrics"]["loop_cost_p50_us"])
            if len(medians_us) == 1:
                os.kill(timer, signal.SIGKILL)
        assert pid_of(client, "timer") != timer
    assert len(medians_us) == 4 and min(medians_us) > 0.0


def test_the_command_on_a_cluster_of_its_own(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = [*words(folder, "b.stl"), "-o", str(folder / "out.db"), "--scheduler", "local", "--workers", "1"]
    assert tuning.cli.run(["compare", *asked]) == 0
    assert "2 of 2 cells on 1 scan" in capsys.readouterr().out


def test_no_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tuning.compare.cluster._CONNECT_S", 0.3)
    with pytest.raises(InputError, match="no scheduler answers"):
        DaskWorkers("tcp://127.0.0.1:1", 0)
