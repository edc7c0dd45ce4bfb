"""The statuses that commands end with: those of a run of hosts, and the numbers of sysexits for all else.

Which command ends with which is in `lfield/docs/exit-statuses.md`; exceptions bring theirs along (errors.py).
The worst of several hosts is told: who reads only the number must not take a vehicle in the air for a mission
that failed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

#: All is well; of a mission: every coordinator has ended as its program wanted.
DONE = 0
#: A coordinator died, was stopped before its end, or is lost for certain; a check of `kit` failed.
FAILED = 1
#: A device has not been seen in its safe state and at rest: somebody must look at it, now.
UNSAFE = 3
#: Another host was not heard of for too long: what became of the mission there is not known.
UNKNOWN_OUTCOME = 4
#: The command line makes no sense.
USAGE = 64
#: What a file says is wrong: a program, deployment, bundle, devices file, registry, dump, journal or key.
DATA = 65
#: A file cannot be read.
NO_INPUT = 66
#: A port, address, driver, device, host or mission that is needed is not there, or is in use.
UNAVAILABLE = 69
#: A bug in lfield.
SOFTWARE = 70
#: A file cannot be written.
NO_OUTPUT = 73
#: What is printed finds no reader, or no room.
INPUT_OUTPUT = 74
#: A peer breaks the protocol between hosts, or is none of the team.
PROTOCOL = 76
#: Somebody stopped it.
INTERRUPTED = 130

#: For people, in the order of the numbers.
MEANINGS: Mapping[int, str] = {
    DONE: "success",
    FAILED: "the mission failed: a coordinator died or is lost; `kit`: a test failed; "
    "`query`: no agent provides the capability",
    UNSAFE: "a device is not confirmed to be at rest in its safe state: look at it",
    UNKNOWN_OUTCOME: "a host was unreachable for too long: the state of the mission there is unknown",
    USAGE: "invalid command line",
    DATA: "invalid program, deployment, bundle, devices file, registry, dump, journal or key",
    NO_INPUT: "cannot read a file",
    UNAVAILABLE: "a port, address, driver, device, host, mission or journal is unavailable",
    SOFTWARE: "a bug in lfield (`LFIELD_TRACEBACK=1` shows it)",
    NO_OUTPUT: "cannot write a file",
    INPUT_OUTPUT: "cannot write the output",
    PROTOCOL: "protocol error between hosts",
    INTERRUPTED: "interrupted",
}

#: From harmless to the one that must be told; a status that is not here counts between FAILED and UNHEARD.
_SEVERITY = (DONE, INTERRUPTED, FAILED, None, UNKNOWN_OUTCOME, UNSAFE)


def most_severe(statuses: Iterable[int]) -> int:
    """The status that must be told, of several; DONE of none. Of failures that weigh alike the first."""
    return max(statuses, key=_severity, default=DONE)


def _severity(status: int) -> int:
    return _SEVERITY.index(status if status in _SEVERITY else None)
