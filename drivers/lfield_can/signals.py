"""CanSignals: a device defined by the messages of a DBC file. The binding lists what may be sent."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence

from lfield.driver import Clock, Device, DeviceBinding, DeviceError, Manifest, Reports
from lfield_can import log_messages
from lfield_can.bus.can_bus import Bus
from lfield_can.bus.frames import Frame
from lfield_can.command_stream import CommandStream, Values, cycles
from lfield_can.dbc import DbcError, DbcFile, Protection, Term, protections
from lfield_can.text_files import log_warnings
from lfield_can.timing import ChangeNotifier

#: Seconds between two checks of a silent device.
WATCH_INTERVAL = 0.1
#: Seconds until the messages of the safe state are repeated, and until it has failed.
SAFE_REPEAT, SAFE_TIMEOUT = 0.1, 3.0
#: Seconds between two log lines about cyclic frames that were not sent.
OVERRUN_INTERVAL = 10.0
#: Kinds of invalid frames per message that are logged.
MAX_PROBLEMS = 5
NO_CONFIRMATION = "no_confirmation"


class CanSignals(Device):
    """One device of a DBC file."""

    def __init__(
        self,
        binding: DeviceBinding,
        manifest: Manifest,
        clock: Clock,
        reports: Reports,
        bus: Bus,
        unknown_ids: Callable[[], str],
    ) -> None:
        super().__init__(binding, manifest, clock, reports)
        self._unknown_ids = unknown_ids
        self._bus, self._changes = bus, ChangeNotifier(clock)
        self._commands: list[str] = binding.option("commands")
        self._safe: list[Term] = []
        self._confirm: list[Term] = []
        self._accepted: list[Term] = []
        #: The time since which the device has not accepted its cyclic commands.
        self._refused_since: float | None = None
        self._protections: dict[str, Protection] = {}
        self._stream = CommandStream(bus, clock, binding.ttl)
        self._received: dict[str, tuple[float, dict[str, float]]] = {}
        self._malformed = 0
        #: Problems of frames by message, the last first. Each kind is logged once.
        self._problems: dict[str, list[str]] = {}
        #: The time when the last frame of a message was not used, and the reason.
        self._refused: dict[str, tuple[float, str]] = {}
        #: For J1939 messages with any sender: our sender and its time, and other logged senders.
        self._sources: dict[str, tuple[int, float]] = {}
        self._other_sources: set[tuple[str, int]] = set()
        self._lost = self._opened = False
        #: Missed cyclic frames that were logged, and when.
        self._overruns_logged, self._overruns_at = 0, -math.inf

    # -- file and frames --------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Reads the DBC file and the options about it. Raises DeviceError."""
        option = self.binding.option
        try:
            self._file = DbcFile(option("dbc"))
            self._protections = protections(self._file, option("counters"), option("checksums"))
            for name, protection in self._protections.items():
                if name in self._commands:
                    self._file.reserve(name, protection.signals)
            self._safe, self._confirm, self._accepted = map(
                self._file.terms, (option("safe"), option("confirm"), option("accepted"))
            )
            periods = cycles(self._file, option("cyclic"), self._commands)
            self._stream.set_up(self._file, self._safe, self._protections, periods)
            self._check_safe()
        except DbcError as error:
            raise self.error(str(error)) from None
        log_warnings(self._file.warnings, option("dbc"), self.note)

    def _check_safe(self) -> None:
        """Checks that the safe state is a complete message for each command, and is confirmed."""
        for term in self._safe:
            if term.message not in self._commands:
                raise DbcError(f"the safe state sends {term.message}, which is not among its 'commands'")
        for name in self._commands:
            if not any(term.message == name for term in self._safe):
                raise DbcError(f"'safe' has no value for {name}, which is among its 'commands'")
            self._stream.check(name)
        for option, terms in (("confirm", self._confirm), ("accepted", self._accepted)):
            if listed := [term.message for term in terms if term.message in self._commands]:
                raise DbcError(f"{listed[0]} is a command; '{option}' requires a message from the device")
        if self._commands and not self._confirm and not self.binding.waives(NO_CONFIRMATION):
            raise DbcError(
                "nothing would confirm that it is safe: add 'confirm', or accept that by 'waivers: "
                f"[{NO_CONFIRMATION}]' in its binding"
            )

    def listens(self) -> frozenset[int]:
        """All messages of the file except commands."""
        return frozenset(self._file.key(name) for name in self._file.names if name not in self._commands)

    def commands(self) -> frozenset[int]:
        """The messages that the driver sends to the device."""
        return frozenset(self._file.key(name) for name in self._commands)

    def on_frame(self, frame: Frame) -> None:
        """Handles a message of the device; deviations from the file are counted and logged, the rest used."""
        decoded = self._file.decode(frame)
        if decoded is None:
            self._malformed += 1
            return
        name, values = decoded
        if self._is_foreign(name, frame):
            return
        protection, now = self._protections.get(name), self.clock.monotonic()
        refusal = protection.problem(frame.data) if protection is not None else ""
        if problem := refusal or self._file.problem(frame):
            self._malformed += 1
            self._report_problem(name, problem)
        if refusal:
            self._refused[name] = now, refusal
            return
        # Only a part of a multiplexed message has arrived; the other values remain, but age.
        self._received[name] = (now, values)
        for signal in values:
            self._received[f"{name}.{signal}"] = self._received[name]
        self.heard()
        self._changes.notify()

    def _is_foreign(self, name: str, frame: Frame) -> bool:
        """Whether a J1939 message with any sender comes from another sender than before."""
        if not self._file.message(name).is_j1939:
            return False
        source, now = frame.id & 0xFF, self.clock.monotonic()
        first, at = self._sources.get(name, (source, now))
        if source == first or now - at > self._max_age:
            self._sources[name] = source, now
            return False
        if (name, source) not in self._other_sources:
            self._other_sources.add((name, source))
            self.note(log_messages.TWO_SOURCES.line(message=name, first=first, second=source))
        return True

    def _report_problem(self, name: str, problem: str) -> None:
        """Logs every kind of invalid frame once."""
        reported = self._problems.setdefault(name, [])
        if problem in reported:
            reported.remove(problem)
        elif len(reported) < MAX_PROBLEMS:
            self.note(log_messages.INVALID_FRAME.line(message=name, reason=problem))
        reported.insert(0, problem)
        del reported[MAX_PROBLEMS:]

    async def watch(self) -> None:
        """Logs loss and recovery of the device."""
        while True:
            await asyncio.sleep(WATCH_INTERVAL)
            if not self._opened:
                continue
            is_silent = self._silence() > self._max_age
            self.publish(online=not is_silent, malformed=self._malformed, overruns=self._stream.overruns)
            self._check_accepted(is_silent)
            self._log_overruns()
            if is_silent == self._lost:
                continue
            self._lost = is_silent
            self.note((log_messages.SILENT if is_silent else log_messages.RESPONDING).line())
            if not is_silent:
                await self._on_recovered()

    async def _on_recovered(self) -> None:
        """Commands the safe state: the state of the device during the loss is unknown."""
        try:
            await self.make_safe()
        except DeviceError as error:
            self.note(log_messages.NOT_SAFE.line(reason=error.reason))

    def _check_accepted(self, is_silent: bool) -> None:
        """Makes a device safe that refuses its cyclic commands, such as their counters, for `max_age`."""
        now = self.clock.monotonic()
        mismatches = (
            self._mismatches(self._accepted, -math.inf) if self._stream.is_streaming and not is_silent else []
        )
        if not mismatches:
            self._refused_since = None
        elif self._refused_since is None:
            self._refused_since = now
        elif now - self._refused_since > self._max_age:
            self._refused_since = None
            self.breach(f"its commands are not accepted: {', '.join(mismatches)}")

    def _log_overruns(self) -> None:
        count, now = self._stream.overruns, self.clock.monotonic()
        if count > self._overruns_logged and now - self._overruns_at >= OVERRUN_INTERVAL:
            self.note(log_messages.CYCLE_OVERRUN.line(count=count - self._overruns_logged))
            self._overruns_logged, self._overruns_at = count, now

    def set_quiet(self, is_quiet: bool) -> None:
        """Stops cyclic commands; then only messages that the program sets are sent."""
        self._stream.set_quiet(is_quiet)

    def close(self) -> None:
        """Stops the cyclic commands when the driver ends."""
        self._stream.close()

    # -- opening and safe state -------------------------------------------------------------------------

    async def _open(self) -> str:
        timeout: float = self.binding.option("connect")
        if not await self._changes.wait_for(lambda: bool(self._received), timeout):
            if not self.binding.waives(NO_CONFIRMATION):
                if self._refused:
                    texts = "; ".join(f"{name}: {refusal}" for name, (_, refusal) in self._refused.items())
                    raise self.error(f"its messages are not used ({texts}); check 'counters' and 'checksums'")
                unknown_ids = self._unknown_ids()
                other_ids = (
                    f" (other ids were received: {unknown_ids}; are those of the file right?)"
                    if unknown_ids
                    else ""
                )
                raise self.error(
                    f"none of the messages of its DBC file was received at {self.binding.endpoint} within "
                    f"{timeout:g} s{other_ids}; check its power, the wires, the bit rate and the file",
                    timeout=True,
                )
            self.note(log_messages.NOTHING_RECEIVED.line())
        self.publish(online=self._silence() <= self._max_age, malformed=self._malformed, overruns=0)
        self._opened = True
        received = sorted(name for name in self._received if "." not in name)
        return f"DBC device, received {', '.join(received) or 'nothing'}"

    def _touched(self) -> bool:
        """Always False: opening only listens."""
        return False

    async def _make_safe(self, state: str) -> None:
        self._stream.forget_setpoints()
        end = self.clock.monotonic() + SAFE_TIMEOUT
        while True:
            start = self.clock.monotonic()
            for name in self._commands:
                await self._stream.send_safe(name)
            if await self._changes.wait_for(lambda since=start: self._confirmed(since), SAFE_REPEAT):  # type: ignore[misc]  # a default binds this round's start
                return
            if self.clock.monotonic() >= end:
                break
        raise self.error(f"its safe state is not confirmed: {self._failure_text()}")

    def _confirmed(self, since: float) -> bool:
        """Whether all confirming signals were received after a time, with matching values."""
        return all(self._fits(term, since) for term in self._confirm)

    def _fits(self, term: Term, since: float) -> bool:
        at, values = self._received.get(f"{term.message}.{term.signal}", (-math.inf, {}))
        return at > since and abs(values[term.signal] - term.value) <= term.within

    def _failure_text(self) -> str:
        mismatches = self._mismatches(self._confirm, self.clock.monotonic() - self._max_age)
        return ", ".join(mismatches) or "its confirming messages came too rarely"

    def _mismatches(self, terms: Sequence[Term], since: float) -> list[str]:
        """Signals that were not received after a time or do not match; one text each."""
        mismatches = []
        for term in terms:
            _, values = self._received.get(f"{term.message}.{term.signal}", (0.0, {}))
            if not self._fits(term, since):
                is_missing = self._is_missing(term.message, term.signal)
                absence = f"absent ({self._problems[term.message][0]})" if is_missing else "no message"
                mismatches.append(f"{term.message}.{term.signal} is {values.get(term.signal, absence)}")
        return mismatches

    def _moving(self) -> str:
        """The reason why the device may move, or '': a file describes no motion, so the device is at rest
        while its safe state is confirmed.
        """
        if not self._confirm:
            return ""
        silence = self._silence()
        if silence > self._max_age:
            return f"no message for {silence:.1f} s"
        return ", ".join(self._mismatches(self._confirm, -math.inf))

    # -- instructions -----------------------------------------------------------------------------------

    async def do_set(self, signal: str, value: float) -> None:
        """Sets one signal and sends its message."""
        message, name = self._split_signal(signal)
        self._check_command(message)
        selected = self._file.selectors(message, name)
        await self._transmit(message, {**self._stream.values(message), **selected, name: value})

    async def do_send(self, message: str, values: list[float]) -> None:
        """Sends a complete message."""
        self._check_command(message)
        names = [signal.name for signal in self._file.message(message).signals]
        if len(values) != len(names):
            raise self.error(f"{message} has {len(names)} signals ({', '.join(names)}), not {len(values)}")
        values_by_name = dict(zip(names, values, strict=True))
        await self._transmit(message, values_by_name)

    async def do_read(self, signal: str) -> float:
        """Returns the last value of a signal, or the next one."""
        message, name = self._split_signal(signal)
        oldest = self.clock.monotonic() - self._max_age

        def is_current() -> bool:
            return self._received.get(f"{message}.{name}", (-math.inf,))[0] >= oldest

        if not await self._changes.wait_for(is_current, self._max_age):
            refused_at, refusal = self._refused.get(message, (-math.inf, ""))
            cause = self._problems[message][0] if self._is_missing(message, name) else self._bus.problem_text
            if refused_at >= oldest:
                cause = refusal
            cause_text = f": {cause}" if cause else ""
            self.publish(online=self._silence() <= self._max_age)
            raise self.error(
                f"{signal} was not received for over {self._max_age:g} s{cause_text}", timeout=True
            )
        return self._received[f"{message}.{name}"][1][name]

    def _is_missing(self, message: str, signal: str) -> bool:
        """Whether the message is received without the signal."""
        at, values = self._received.get(message, (-math.inf, {}))
        is_current = at >= self.clock.monotonic() - self._max_age
        return is_current and message in self._problems and signal not in values

    async def do_age_of(self, message: str) -> float:
        """Seconds since a message was received."""
        if message not in self._received:
            raise self.error(f"{message} was never received", timeout=True)
        return self.clock.monotonic() - self._received[message][0]

    # -- parts ------------------------------------------------------------------------------------------

    @property
    def _max_age(self) -> float:
        max_age: float = self.binding.option("max_age")
        return max_age

    def _silence(self) -> float:
        """Seconds since the last message of any kind."""
        return self.clock.monotonic() - max((at for at, _ in self._received.values()), default=-math.inf)

    def _split_signal(self, signal: str) -> tuple[str, str]:
        try:
            return self._file.split(signal)
        except DbcError as error:
            raise self.error(str(error)) from None

    def _check_command(self, message: str) -> None:
        if message not in self._commands:
            listed = f"only {', '.join(self._commands)}" if self._commands else "nothing"
            raise self.error(f"{message} may not be sent: the binding's 'commands' allow {listed}")

    async def _transmit(self, message: str, values: Values) -> None:
        try:
            await self._stream.send(message, values)
        except DbcError as error:
            raise self.error(str(error)) from None
