"""Runs the mission four times on fakes: as it is, then with one more robot that has failed each time.

    python examples/02-equivalent-lift/demo.py

Each run is `lfield up --all --sim --until-done`; once the hook is down, the faults of the run are set with
`lfield sim fault`, as one could by hand from another terminal.
"""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
from pathlib import Path

from lfield import exits
from lfield.cli.main import main as lfield

MISSION = Path(__file__).with_name("mission.dL")

#: What hosts and devices say of themselves; the rest is the foreman's.
OTHERS = re.compile(r"\| (\w+\.\w+: |\w+ is up|linked with|lost the link|waiting for the devices)")

#: What fails in each run besides what has failed before: the device, its fault, and how people would say it.
FAILURES = (
    ("", "", "everything works"),
    ("crane.axis", "silence=true", "the crane's drive has lost its power"),
    ("sky.fc", "battery=0.15", "the copter's battery is low as well"),
    ("hand.motor", "dead=true", "and the hand's servo is dead"),
)


def run(failures: tuple[tuple[str, str, str], ...]) -> int:
    """One run with these failures; returns how the mission ended."""
    options = ("--deploy", str(MISSION), "--all", "--sim", "--until-done")
    command = [sys.executable, "-m", "lfield", "up", *options]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as mission:
        assert mission.stderr
        for line in mission.stderr:
            if not OTHERS.search(line):
                print(line, end="", flush=True)
            if "the parcel is coming" in line:
                fail(failures)
        return mission.wait()


def fail(failures: tuple[tuple[str, str, str], ...]) -> None:
    """Set the faults of the fakes.

    The team must have noticed all of them when the parcel is there. So they are set from this process: on a
    busy computer a process for each could come too late.
    """
    for device, fault, words in failures:
        if device:
            with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
                status = lfield(["sim", "fault", device, fault])
            assert status == 0, f"{device} has not taken {fault}"
        print(f"      | ({words})", flush=True)


def main() -> int:
    """All four runs, until one does not end as it should.

    A device that has failed cannot be seen in its safe state: such a run ends with 3, however well the
    mission went.
    """
    for count, (_, _, words) in enumerate(FAILURES, 1):
        print(f"\nRun {count}: {words}", flush=True)
        status = run(FAILURES[1:count])
        if status != (exits.DONE if count == 1 else exits.UNSAFE):
            print(f"the mission ended with {status}", file=sys.stderr)
            return exits.FAILED
    return exits.DONE


if __name__ == "__main__":
    sys.exit(main())
