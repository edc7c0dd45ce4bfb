"""Sends the commands of a device of a DBC file: with counter and checksum, once or cyclically.

A cyclic command stops with the guard: it is sent by the loop that checks the host's heartbeats, never by the
timers of a kernel or an adapter (python-can's `send_periodic`), which continue when the guard hangs. A
setpoint is repeated for its time-to-live only; then the values of the safe state follow.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from lfield.driver import Clock
from lfield_can.bus.can_bus import Bus
from lfield_can.bus.frames import Frame
from lfield_can.dbc import DbcError, DbcFile, Protection, Term
from lfield_can.timing import PeriodicTask

#: Shortest and longest period of a cyclic command in seconds.
SHORTEST, LONGEST = 0.001, 10.0
_CYCLE = re.compile(r"\s*([^=\s]+)\s*(?:=\s*([0-9.eE+-]+)\s*)?")

Values = Mapping[str, float]


def cycles(file: DbcFile, texts: Sequence[str], commands: Sequence[str]) -> dict[str, float]:
    """The periods in `cyclic`, in seconds by message: `Motor=0.02`, or `Motor` for that of the file.

    Raises DbcError.
    """
    periods = {}
    for text in texts:
        match = _CYCLE.fullmatch(text)
        if match is None:
            raise DbcError(f"'{text}' does not have the form Message or Message=SECONDS")
        name = match[1]
        if name not in commands:
            raise DbcError(f"{name} cannot be cyclic: it is not among its 'commands'")
        try:
            period = float(match[2]) if match[2] else file.message(name).cycle
        except ValueError:
            raise DbcError(f"'{match[2]}' is not a number") from None
        if not match[2] and not period:
            raise DbcError(f"the file gives no GenMsgCycleTime for {name}; write its period: {name}=0.02")
        if not SHORTEST <= period <= LONGEST:
            raise DbcError(f"the period of {name} is {SHORTEST:g} to {LONGEST:g} s, not {period:g} s")
        periods[name] = period
    return periods


class CommandStream:
    """The commands of one device, and the values in them."""

    def __init__(self, bus: Bus, clock: Clock, ttl: float) -> None:
        self._bus, self._clock, self._ttl = bus, clock, ttl
        self._protections: Mapping[str, Protection] = {}
        self._periods: Mapping[str, float] = {}
        self._safe: dict[str, Values] = {}
        self._values: dict[str, Values] = {}
        self._expiry: dict[str, float] = {}
        self._tasks: dict[str, PeriodicTask] = {}
        #: Messages that are sent cyclically, also while the bus is quiet.
        self._streaming: set[str] = set()
        self._is_quiet = False

    def set_up(
        self,
        file: DbcFile,
        safe: Sequence[Term],
        protections: Mapping[str, Protection],
        periods: Mapping[str, float],
    ) -> None:
        """Sets the file and the values of the safe state before the first command."""
        self._file, self._protections, self._periods = file, protections, periods
        for term in safe:
            self._safe[term.message] = {**self._safe.get(term.message, {}), term.signal: term.value}
        self._values = dict(self._safe)
        self._tasks = {name: PeriodicTask(self._clock) for name in periods}

    @property
    def is_streaming(self) -> bool:
        """Whether commands are sent cyclically now."""
        return bool(self._streaming) and not self._is_quiet

    @property
    def overruns(self) -> int:
        """Cyclic frames that were not sent because this process was late."""
        return sum(task.overruns for task in self._tasks.values())

    def values(self, message: str) -> Values:
        """The values of a message: the safe values, overlaid by setpoints."""
        return self._values[message]

    def check(self, message: str) -> None:
        """Raises DbcError if the safe state of a message cannot be encoded."""
        self._file.encode(message, self._safe[message])

    def forget_setpoints(self) -> None:
        """Discards the setpoints: commands contain the safe values until a new setpoint."""
        self._values = dict(self._safe)
        self._expiry.clear()

    async def send(self, message: str, values: Values) -> None:
        """Sends a message now, and cyclically from then on. Raises DbcError and DeviceError."""
        await self._bus.send(self._frame(message, values))
        self._values[message] = values
        self._expiry[message] = self._clock.monotonic() + self._ttl
        self._start(message)

    async def send_safe(self, message: str) -> None:
        """Sends a message like `send`, with the values of the safe state, which do not expire."""
        await self._bus.send(self._frame(message, self._safe[message]))
        self._start(message)

    def set_quiet(self, is_quiet: bool) -> None:
        """Stops the cyclic frames; they feed the device's own supervision. False: starts them again."""
        self._is_quiet = is_quiet
        for name in self._streaming:
            if is_quiet:
                self._tasks[name].stop()
            else:
                self._tasks[name].resume()

    def close(self) -> None:
        """Stops the cyclic frames when the driver ends."""
        for task in self._tasks.values():
            task.stop()

    def _start(self, message: str) -> None:
        if message not in self._periods:
            return
        self._streaming.add(message)
        self._tasks[message].start(self._periods[message], lambda: self._repeat(message))
        if self._is_quiet:
            self._tasks[message].stop()

    def _repeat(self, message: str) -> None:
        if self._clock.monotonic() >= self._expiry.get(message, math.inf):
            self._values[message] = self._safe[message]
            del self._expiry[message]
        self._bus.post(self._frame(message, self._values[message]))

    def _frame(self, message: str, values: Values) -> Frame:
        frame = self._file.encode(message, values)
        protection = self._protections.get(message)
        return frame if protection is None else frame._replace(data=protection.protected(frame.data))
