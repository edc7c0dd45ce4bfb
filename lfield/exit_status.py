"""Exit statuses of commands: the statuses of missions, and the numbers of sysexits.h for all others.

The statuses of each command are in `lfield/docs/exit-statuses.md`; exceptions contain their statuses
(errors.py). Of several hosts the most severe status counts, so that a script can distinguish a vehicle in the
air from a failed mission.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

#: Success; for a mission: every coordinator has ended as intended by its program.
DONE = 0
#: A coordinator died, was stopped before its end, or is certainly lost; a check of `kit` failed.
FAILED = 1
#: A device is not confirmed at rest in its safe state: a person must check it at once.
UNSAFE = 3
#: Another host was unreachable for too long: the state of the mission there is unknown.
UNKNOWN_OUTCOME = 4
#: The command line is invalid.
USAGE = 64
#: An invalid file: program, deployment, bundle, devices file, registry, dump, journal, key or mission file.
DATA = 65
#: A file cannot be read.
NO_INPUT = 66
#: A port, address, driver, device, host or mission that is needed is missing, or is in use.
UNAVAILABLE = 69
#: A bug in lfield.
SOFTWARE = 70
#: A file cannot be written.
NO_OUTPUT = 73
#: The output has no reader, or no space.
INPUT_OUTPUT = 74
#: A peer violates the protocol between hosts, or is not a member of the team.
PROTOCOL = 76
#: Interrupted by the user.
INTERRUPTED = 130

#: The texts for people, in the order of the numbers.
MEANINGS: Mapping[int, str] = {
    DONE: "success",
    FAILED: "the mission failed: a coordinator died or is lost; `kit`: a check failed; "
    "`query`: no agent provides the capability; `fmt --check`: a file would change",
    UNSAFE: "a device is not confirmed to be at rest in its safe state: look at it",
    UNKNOWN_OUTCOME: "a host was unreachable for too long: the state of the mission there is unknown",
    USAGE: "invalid command line",
    DATA: "invalid program, deployment, bundle, devices file, registry, dump, journal, key or mission file",
    NO_INPUT: "cannot read a file",
    UNAVAILABLE: "a port, address, driver, device, host, mission or journal is unavailable",
    SOFTWARE: "a bug in lfield (`LFIELD_TRACEBACK=1` shows it)",
    NO_OUTPUT: "cannot write a file",
    INPUT_OUTPUT: "cannot write the output",
    PROTOCOL: "protocol error between hosts",
    INTERRUPTED: "interrupted",
}

#: The statuses from the least to the most severe; other statuses count between FAILED and UNKNOWN_OUTCOME.
_SEVERITY = (DONE, INTERRUPTED, FAILED, None, UNKNOWN_OUTCOME, UNSAFE)


def most_severe(statuses: Iterable[int]) -> int:
    """The most severe of several statuses; the first of equally severe ones; DONE for none."""
    return max(statuses, key=_severity, default=DONE)


def _severity(status: int) -> int:
    return _SEVERITY.index(status if status in _SEVERITY else None)
