"""The operator of a mission under test: pauses and resumes it, and enters lines of input.

A pause is sent as by `lfield pause`: as an order, which each host executes once. A line goes where the host's
process would read its standard input: into the core, whether an agent waits for it or not.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, cast

from lfield.authority.identity import ALL_RIGHTS, Identity
from lfield.errors import MissionTestError
from lfield.host.inputs import LineEntered
from lfield.net.transport import Link
from lfield.wire.observer_messages import Pause, with_epoch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lfield.simulate.host_fleet import Fleet


class OperatorLink:
    """The link of an operator with all rights, who ignores the answers."""

    peer = "the test"
    identity = Identity("person", peer, ALL_RIGHTS)

    def send(self, message: object) -> None:
        """Ignore an answer."""


class MissionOperator:
    """The operator of a fleet; `readers` are the hosts with resources that read input."""

    def __init__(self, fleet: Fleet, readers: Sequence[str]) -> None:
        self._fleet, self._readers, self._orders = fleet, readers, 0

    def pause(self, *, lift: bool) -> None:
        """Pauses the mission on all hosts that run, or with `lift` resumes it."""
        self._orders += 1
        order = Pause(self._orders.to_bytes(16), lift)
        for run in self._fleet.runs.values():
            command = with_epoch(order, run.core.orders.epochs)
            run.process.loop.enter(partial(run.host.on_message, "", command, cast(Link, OperatorLink())))

    def type_line(self, host: str, text: object) -> None:
        """Enters a line where a host runs, at the end of the present moment. Raises MissionTestError."""
        call = f"type_line({host!r}, {text!r})"
        if not isinstance(text, str) or "\n" in text:
            raise MissionTestError(f"{call}: give one line of text, without its newline")
        if host not in self._readers:
            known = ", ".join(self._readers) or "none"
            raise MissionTestError(
                f"{call}: no resource of {host} reads input; these hosts have one: {known}"
            )
        self._fleet.later(0.0, partial(self._enter, host, text))

    def _enter(self, host: str, text: str) -> None:
        if (run := self._fleet.runs.get(host)) is not None:
            run.process.loop.enter(partial(run.host.dispatch, LineEntered(text)))
