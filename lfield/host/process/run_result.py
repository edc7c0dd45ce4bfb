"""The result of a host: hops, exit status and the reason of a failure, written for the process that started
it.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress

import msgspec

from lfield import exit_status
from lfield.errors import BindingError, LfieldError
from lfield.wire.coordinator_messages import CoordinatorState

#: The codes of log lines that explain an exit status, before all other errors.
_CODES: Mapping[int, tuple[str, ...]] = {
    exit_status.UNSAFE: ("device-not-safe", "device-locked-out"),
    exit_status.UNKNOWN_OUTCOME: ("agent-unreachable",),
    exit_status.FAILED: ("agent-died", "agent-lost"),
    exit_status.SOFTWARE: ("agent-died", "host-failed"),
}
#: Codes whose log lines do not explain an exit status.
_IGNORED = ("traceback",)
#: Bounds of the result, in bytes: a pipe takes 64 KiB at once, and the parent reads it at the end.
MAX_REASON, MAX_RESULT = 1000, 60_000


class RunResult(msgspec.Struct, frozen=True):
    """`hops` are the hops of each start of a coordinator, as far as this host knows them. `reason` may be ''.

    `status` is the exit status, None if the host was killed before it wrote one.
    """

    hops: dict[str, int] = {}
    reason: str = ""
    status: int | None = None

    def write(self, pipe: int) -> None:
        """Write the result once; not if the parent has ended or the pipe is full."""
        data = msgspec.json.encode(self)
        if len(data) > MAX_RESULT:
            data = msgspec.json.encode(RunResult(reason=self.reason, status=self.status))
        os.set_blocking(pipe, False)
        with suppress(OSError):
            os.write(pipe, data)


def read_result(pipe: int) -> RunResult:
    """The result of a host, empty if the host was killed before it wrote one. Closes the pipe."""
    os.set_blocking(pipe, False)
    with suppress(msgspec.DecodeError), os.fdopen(pipe, "rb", 0) as reader:
        # None if the guard of the host still holds the pipe.
        return msgspec.json.decode(reader.read(MAX_RESULT + 1) or b"", type=RunResult)
    return RunResult()


def known_hops(states: Iterable[CoordinatorState]) -> dict[str, int]:
    """The hops of each start of a coordinator that a host knows: the count for a coordinator that has left
    the host includes that hop.
    """
    found = {}
    for known in states:
        has_left = known.state == "MOVED" or (known.outcome == "lost" and known.sequence > 0)
        found[f"{known.agent} {known.generation}"] = known.hops + has_left
    return found


def failure_reason(status: int, errors: dict[str, str]) -> str:
    """The log line that explains an exit status, of the newest error of each code; '' if there is none."""
    if status in (exit_status.DONE, exit_status.INTERRUPTED):
        return ""
    ordered = [code for code in _CODES.get(status, ()) if code in errors]
    ordered += [code for code in reversed(errors) if code not in _IGNORED]
    return _first_line(errors[ordered[0]]) if ordered else ""


def refusal_reason(error: LfieldError) -> str:
    """The first problem of an error with which a host cannot start."""
    return _first_line(error.problems[0] if isinstance(error, BindingError) else str(error))


def _first_line(text: str) -> str:
    return text.partition("\n")[0][:MAX_REASON]
