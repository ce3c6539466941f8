"""Workers of a Dask cluster. Dask tries a task again whose worker died; what is timed goes to workers marked for it.

Start those that may time with `dask worker ADDRESS --nthreads 1 --resources timing=1`. Resources do not keep timings of
one host apart, so one worker per host is chosen here and given one task at a time, after everything else is done.
All workers must see the scans and tools under the same paths, and run the same HapticLOD.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from hapticlod.errors import InputError
from tuning.compare.cell import measuring_digest
from tuning.compare.task import Outcome, Task, perform

LOCAL = "local"
TIMING = "timing"
TRIES = 3
_CONNECT_S = 10.0  # for a scheduler to answer, or a first worker to come
_LOOK_S = 2.0  # how often to see whether workers are still there
_RETURN_S = 60.0  # how long to wait for workers that were there to come back
_LOST = "the worker was lost"


@dataclass(frozen=True)
class _Place:
    """Where a task is timed."""

    task: Task
    host: str
    address: str


class DaskWorkers:
    """Executes tasks on a cluster: an existing one by its scheduler's address, or "local": `workers` processes here.

    Raises:
        InputError: distributed is not installed, no scheduler answers, or a worker runs other code.
    """

    def __init__(self, scheduler: str, workers: int) -> None:
        try:
            import distributed
        except ImportError:
            raise InputError("--scheduler", "Dask is not installed", "install hapticlod[cluster]") from None
        self._cluster: Any = None
        address = scheduler
        if scheduler == LOCAL:
            self._cluster = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                resources={TIMING: 1},
                dashboard_address="127.0.0.1:0",
                protocol="tcp://",
            )
            address = self._cluster.scheduler_address
        try:
            # What is sent and brought back is small and stays on this client: no files, no dashboard.
            self._client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            what = f"no scheduler answers ({' '.join(str(error).split())})"
            raise InputError(f"--scheduler {scheduler}", what, "start one with `dask scheduler`") from None

    def __enter__(self) -> DaskWorkers:
        return self

    def __exit__(self, *ended: object) -> None:
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def outcomes(self, tasks: Sequence[Task], *, alone: bool) -> Iterator[tuple[Task, Outcome]]:
        """Each task with its outcome, as they come. `alone`: one at a time on each host that has a worker for it."""
        if not tasks:
            return
        self._check_code()
        yield from self._timed(tasks) if alone else self._spread(tasks)

    def _spread(self, tasks: Sequence[Task]) -> Iterator[tuple[Task, Outcome]]:
        from distributed import as_completed

        futures = {self._submit(task): task for task in tasks}
        for future in as_completed(list(futures), loop=self._client.loop):
            task = futures.pop(future)
            yield task, _outcome(future)
            future.release()

    def _timed(self, tasks: Sequence[Task]) -> Iterator[tuple[Task, Outcome]]:
        from distributed import wait

        waiting = list(tasks)
        tried: dict[str, int] = {}
        running: dict[Any, _Place] = {}
        patience_s, without_since = 0.0, time.monotonic()
        while waiting or running:
            marked = self._timing_workers()
            if marked:
                patience_s, without_since = _RETURN_S, time.monotonic()
            for host, address in marked.items():
                if waiting and host not in {place.host for place in running.values()}:
                    task = waiting.pop(0)
                    running[self._submit(task, address, tried.get(task.key, 0))] = _Place(task, host, address)
            if not running:
                if time.monotonic() - without_since < patience_s:  # one that died may be started again
                    time.sleep(0.1)
                    continue
                what = f"no worker is marked for timing, {len(waiting)} cells wait"
                raise InputError("--scheduler", what, f"start one with `dask worker --resources {TIMING}=1`")
            with contextlib.suppress(TimeoutError), self._client.as_current():
                wait(list(running), timeout=_LOOK_S, return_when="FIRST_COMPLETED")
            addresses = self._addresses()
            for future, place in list(running.items()):
                # A task that is bound to a worker which is gone would wait for it forever.
                lost = not future.done() and place.address not in addresses
                if not future.done() and not lost:
                    continue
                outcome = Outcome(error=_LOST) if lost else _outcome(future)
                future.cancel()
                del running[future]
                if outcome.result is None and outcome.error.startswith(_LOST):
                    tried[place.task.key] = tried.get(place.task.key, 0) + 1
                    if tried[place.task.key] < TRIES:
                        waiting.insert(0, place.task)
                        continue
                yield place.task, outcome

    def _submit(self, task: Task, address: str | None = None, attempt: int = 0) -> Any:
        # Not pure: a cluster must not answer a timing with one it remembers.
        bound = {} if address is None else {"workers": [address], "allow_other_workers": False}
        return self._client.submit(perform, task, key=f"{task.key}-{attempt}", pure=False, **bound)

    def _addresses(self) -> dict[str, Any]:
        """What the scheduler knows of each worker."""
        return self._client.scheduler_info(n_workers=-1)["workers"]

    def _timing_workers(self) -> dict[str, str]:
        """Address of one worker marked for timing, by host."""
        workers = self._addresses()
        marked = {a: w for a, w in sorted(workers.items()) if w.get("resources", {}).get(TIMING, 0) >= 1}
        return {str(worker["host"]): address for address, worker in reversed(marked.items())}

    def _check_code(self) -> None:
        if not self._addresses():
            try:
                self._client.wait_for_workers(1, timeout=_CONNECT_S)
            except TimeoutError:
                raise InputError("--scheduler", "has no worker", "start some with `dask worker`") from None
        codes: Any = self._client.run(measuring_digest)
        other = [address for address, code in codes.items() if code != measuring_digest()]
        if other:
            raise InputError(
                f"worker {other[0]}", "runs another HapticLOD than this one", "install the same everywhere"
            )


def _outcome(future: Any) -> Outcome:
    from distributed import KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        return Outcome(error=f"{_LOST} {' '.join(str(error).split())}")
    except Exception as error:  # of the cluster itself: cancelled, unreadable
        return Outcome(error=f"{_LOST}: {type(error).__name__} {' '.join(str(error).split())}")
