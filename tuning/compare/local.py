"""Worker processes on this machine. One that dies costs its task a second try and nothing else.

A process pool of the standard library gives up every task when a worker dies; here each worker has its own pipe.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from tuning.compare.task import Outcome, Task, perform

TRIES = 2
_PR_SET_PDEATHSIG = 1


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    task: Task
    ground: tuple[str, ...]


class LocalWorkers:
    """Executes tasks in up to `workers` processes of their own."""

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def __enter__(self) -> LocalWorkers:
        return self

    def __exit__(self, *ended: object) -> None:
        """Nothing outlives `outcomes`."""

    def outcomes(self, tasks: Sequence[Task], *, alone: bool) -> Iterator[tuple[Task, Outcome]]:
        """Each task with its outcome, as they come. `alone`: one task at a time on the whole machine."""
        waiting = list(tasks)
        tried: dict[str, int] = {}
        running: list[_Worker] = []
        most = 1 if alone else self.workers
        try:
            while waiting or running:
                while waiting and len(running) < most:
                    running.append(_start(_next(waiting, [worker.ground for worker in running], None)))
                ready = wait([worker.pipe for worker in running])
                for worker in [worker for worker in running if worker.pipe in ready]:
                    task = worker.task
                    try:
                        outcome: Outcome = worker.pipe.recv()
                    except (EOFError, OSError):
                        running.remove(worker)
                        tried[task.key] = tried.get(task.key, 0) + 1
                        if tried[task.key] < TRIES:
                            waiting.insert(0, task)
                        else:
                            yield task, Outcome(error=f"the worker {_ended(worker)}, {TRIES} times")
                        continue
                    others = [other.ground for other in running if other is not worker]
                    if waiting:
                        worker.task = _next(waiting, others, worker.ground)
                        worker.ground = worker.task.cell.ground
                        worker.pipe.send(worker.task)
                    else:
                        running.remove(worker)
                        _stop(worker)
                    yield task, outcome
        finally:
            for worker in running:
                worker.process.kill()
                _stop(worker)


def _next(waiting: list[Task], busy: Sequence[tuple[str, ...]], own: tuple[str, ...] | None) -> Task:
    """The task whose scan the worker has already, else one of a scan that no other worker is at."""
    for fits in (lambda g: g == own, lambda g: g not in busy, lambda g: True):
        for task in waiting:
            if fits(task.cell.ground):
                waiting.remove(task)
                return task
    raise IndexError("no task is waiting")


def _start(task: Task) -> _Worker:
    # Spawned, not forked: the comparison itself may hold threads and an open ledger.
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, os.getpid()), daemon=True)
    process.start()
    theirs.close()
    ours.send(task)
    return _Worker(process, ours, task, task.cell.ground)


def _stop(worker: _Worker) -> None:
    worker.pipe.close()
    worker.process.join()


def _ended(worker: _Worker) -> str:
    worker.process.join()
    code = worker.process.exitcode or 0
    return f"was ended by signal {-code}" if code < 0 else f"ended with status {code}"


def _work(pipe: Connection, parent: int) -> None:
    """A worker: tasks in, outcomes out, until the pipe is closed; it ends with the process that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to answer
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        return
    while True:
        try:
            task = pipe.recv()
            pipe.send(perform(task))
        except (EOFError, OSError):
            return
