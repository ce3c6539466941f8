"""The `hapticlod` command: what to call, how faults reach the user, which status is returned.

Status: 0 done, 2 the input cannot be used (one line says where, what and what to do), 3 done in part, 130 interrupted.
Commands live in tuning/commands/ and are imported when called: `hapticlod --help` loads neither jax nor a mesh reader.
"""

import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType
from typing import NoReturn

from cyclopts import App, CycloptsError

from hapticlod.errors import HapticLODError
from tuning.commands.status import BAD_INPUT, DONE, FAILED, INTERRUPTED, TERMINATED


def _version() -> str:
    import hapticlod

    return f"hapticlod {hapticlod.__version__}"


app = App(
    name="hapticlod",
    help="Tune levels of detail of a scan for a haptic loop, and look into the result.",
    version=_version,
    help_format="plaintext",
    suppress_keyboard_interrupt=False,  # ours to answer: the user is told that nothing was written
)
app.command("tuning.commands.tune:tune_command", name="tune", help="Tune a scan for a station and a tool.")
app.command(
    "tuning.commands.calibrate:calibrate_command", name="calibrate", help="Measure what a tick costs on this machine."
)
app.command("tuning.commands.check:check_command", name="check", help="Say what is wrong with a scan.")
app.command("tuning.commands.pareto:pareto_command", name="pareto", help="Show what each budget buys, on one scan.")
app.command("tuning.commands.devices:devices_command", name="devices", help="List, watch and record HID devices.")
app.command(
    "tuning.commands.recording:recording_command", name="recording", help="Turn a station's recording into CSV."
)
app.command("tuning.commands.compare:compare_command", name="compare", help="Rank configurations over many scans.")
app.command("tuning.commands.experiment:experiment_command", name="experiment", help="Redraw the paper's figures.")
app.command("tuning.commands.report:report_command", name="report", help="Write a page about a bundle or comparison.")
app.command("tuning.commands.inspect:inspect_command", name="inspect", help="Show what a bundle holds.")
app.command("tuning.commands.deploy:deploy_command", name="deploy", help="Install a bundle on a station over ssh.")
app.command("tuning.commands.deploy:pack_command", name="pack", help="The same as one file, without a network.")
app.command("tuning.commands.key:key_app", name="key", help="Sign bundles, and say whose bundles to trust.")


def run(tokens: Sequence[str], program: App = app) -> int:
    """Carry out one command line and return its exit status; faults are printed as one line on standard error."""
    name = program.name[0]
    try:
        status = program(list(tokens), exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except CycloptsError as error:
        return _say(f"{name}: {str(error).rstrip('.')}; see {name} --help", BAD_INPUT)
    except HapticLODError as error:
        return _say(str(error), BAD_INPUT)
    except KeyboardInterrupt:
        return _say("interrupted; nothing was written", INTERRUPTED)
    except BrokenPipeError:  # the reader of our output went away: `hapticlod inspect x.hlod | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    return status if isinstance(status, int) else DONE


def _say(line: str, status: int) -> int:
    print(" ".join(line.split()), file=sys.stderr)
    return status


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(TERMINATED)


def main() -> NoReturn:
    """Entry point of the console script."""
    signal.signal(signal.SIGTERM, _terminate)  # unwind as for Ctrl-C: part files removed, workers ended
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
