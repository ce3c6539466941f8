"""Run one command and say what it took: wall and processor time, greatest resident memory, status, what it printed."""

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

_POLL_S = 0.1


@dataclass(frozen=True)
class Taken:
    """What a command took.

    Attributes:
        status: exit status; negative: the signal that ended it; None: it was stopped after `limit_s`.
        wall_s, processor_s: seconds. peak_mb: greatest resident memory of the process, 10^6 bytes; Linux counts from
            the fork on, so it is never less than what the caller held then.
        out, err: what it printed.
    """

    status: int | None
    wall_s: float
    processor_s: float
    peak_mb: float
    out: str
    err: str

    @property
    def last_line(self) -> str:
        """The last line on standard error: where a refusal says why."""
        lines = [line.strip() for line in self.err.splitlines() if line.strip()]
        return lines[-1] if lines else ""


def run_measured(command: Sequence[str], limit_s: float, environment: Mapping[str, str]) -> Taken:
    """Run a command in a session of its own, with `environment` added to ours; it is stopped after `limit_s`."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        begun = time.monotonic()
        child = subprocess.Popen(
            command, stdout=out, stderr=err, stdin=subprocess.DEVNULL, env={**os.environ, **environment},
            start_new_session=True,
        )  # fmt: skip
        late = False
        try:
            while (ended := os.wait4(child.pid, os.WNOHANG))[0] == 0:
                if not late and time.monotonic() - begun > limit_s:
                    late = True
                    os.killpg(child.pid, signal.SIGKILL)
                time.sleep(_POLL_S)
        except BaseException:  # Ctrl-C: the child is in another session and would go on
            os.killpg(child.pid, signal.SIGKILL)
            os.waitpid(child.pid, 0)
            raise
        wall_s = time.monotonic() - begun
        child.returncode = os.waitstatus_to_exitcode(ended[1])  # waited for: Popen need not
        used = ended[2]
        out.seek(0)
        err.seek(0)
        return Taken(
            status=None if late else child.returncode,
            wall_s=wall_s,
            processor_s=used.ru_utime + used.ru_stime,
            peak_mb=used.ru_maxrss * 1024 / 1e6,
            out=out.read().decode("utf-8", "replace"),
            err=err.read().decode("utf-8", "replace"),
        )
