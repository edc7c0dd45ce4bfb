"""CanSignals: a device that is nothing but the messages of a DBC file. What may be sent, the binding says."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from lfield.driver import Clock, Device, DeviceBinding, DeviceError, Manifest, Reports
from lfield_can.bus.bus import Bus
from lfield_can.bus.frames import Frame
from lfield_can.dbc import DbcError, DbcFile, Term
from lfield_can.files import tell_warnings
from lfield_can.timing import News

#: Seconds between two looks at a device that says nothing.
LOOK = 0.1
#: Seconds until the messages of the safe state are sent again, and until the attempt is given up.
SAFE_AGAIN, SAFE_BY = 0.1, 3.0
#: Kinds of wrong frames of one message that are told.
PROBLEMS = 5
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
        self._bus, self._news = bus, News(clock)
        self._commands: list[str] = binding.option("commands")
        self._safe: list[Term] = []
        self._confirm: list[Term] = []
        # What each command carries: the safe values, and over them what was set since.
        self._sent: dict[str, dict[str, float]] = {}
        self._received: dict[str, tuple[float, dict[str, float]]] = {}
        self._malformed = 0
        #: What was wrong with frames, by message, the last kind first. Each kind is told once.
        self._problems: dict[str, list[str]] = {}
        #: Of messages of J1939 that anybody may send: who sends ours and when, and who else was told of.
        self._sources: dict[str, tuple[int, float]] = {}
        self._other_sources: set[tuple[str, int]] = set()
        self._lost = self._opened = False

    # -- the file and the frames ------------------------------------------------------------------------

    def prepare(self) -> None:
        """Read the DBC file and what the options say about it. Raises DeviceError."""
        option = self.binding.option
        try:
            self._file = DbcFile(option("dbc"))
            self._safe, self._confirm = self._file.terms(option("safe")), self._file.terms(option("confirm"))
            self._forget_setpoints()
            self._check_safe()
        except DbcError as error:
            raise self.error(str(error)) from None
        tell_warnings(self._file.warnings, option("dbc"), self.note)

    def _check_safe(self) -> None:
        """The safe state must be a whole message for each command, and be seen."""
        for term in self._safe:
            if term.message not in self._commands:
                raise DbcError(f"the safe state sends {term.message}, which is not among its 'commands'")
        for name in self._commands:
            if not any(term.message == name for term in self._safe):
                raise DbcError(f"'safe' says nothing about {name}, which is among its 'commands'")
            self._file.encode(name, self._sent[name])
        for term in self._confirm:
            if term.message in self._commands:
                raise DbcError(f"{term.message} is a command; 'confirm' is about what the device says")
        if self._commands and not self._confirm and not self.binding.waives(NO_CONFIRMATION):
            raise DbcError(
                "nothing would show that it is safe: give 'confirm', or accept that by "
                f"'waivers: [{NO_CONFIRMATION}]' in its binding"
            )

    def listens(self) -> frozenset[int]:
        """Every message of the file that is not a command."""
        return frozenset(self._file.key(name) for name in self._file.names if name not in self._commands)

    def commands(self) -> frozenset[int]:
        """The messages that it sends."""
        return frozenset(self._file.key(name) for name in self._commands)

    def on_frame(self, frame: Frame) -> None:
        """A message of the device; what is not as the file says is counted and told, and the rest used."""
        decoded = self._file.decode(frame)
        if decoded is None:
            self._malformed += 1
            return
        name, values = decoded
        if self._is_foreign(name, frame):
            return
        if problem := self._file.problem(frame):
            self._malformed += 1
            self._tell_problem(name, problem)
        # Of a multiplexed message only a part has come; the rest is still what it was, but grows old.
        self._received[name] = (self.clock.monotonic(), values)
        for signal in values:
            self._received[f"{name}.{signal}"] = self._received[name]
        self.heard()
        self._news.tell()

    def _is_foreign(self, name: str, frame: Frame) -> bool:
        """Whether a message of J1939 that anybody may send comes from another than the one that is heard."""
        if not self._file.message(name).is_j1939:
            return False
        source, now = frame.id & 0xFF, self.clock.monotonic()
        first, at = self._sources.get(name, (source, now))
        if source == first or now - at > self._patience:
            self._sources[name] = source, now
            return False
        if (name, source) not in self._other_sources:
            self._other_sources.add((name, source))
            self.note(
                f"{name} comes from two addresses, 0x{first:02X} and 0x{source:02X}; the values are those "
                f"of 0x{first:02X}: name the address in the DBC file"
            )
        return True

    def _tell_problem(self, name: str, problem: str) -> None:
        """Every kind of wrong frame is told once."""
        told = self._problems.setdefault(name, [])
        if problem in told:
            told.remove(problem)
        elif len(told) < PROBLEMS:
            self.note(f"{name}: {problem}")
        told.insert(0, problem)
        del told[PROBLEMS:]

    async def watch(self) -> None:
        """Tell when the device is lost and found."""
        while True:
            await asyncio.sleep(LOOK)
            if not self._opened:
                continue
            silent = self._silence() > self._patience
            self.publish(online=not silent, malformed=self._malformed)
            if silent == self._lost:
                continue
            self._lost = silent
            self.note("it is not heard any more" if silent else "heard again")
            if not silent:
                await self._come_back()

    async def _come_back(self) -> None:
        """Nobody knows what it did meanwhile: it starts from its safe state."""
        try:
            await self.make_safe()
        except DeviceError as error:
            self.note(error.reason)

    def quiet(self, on: bool) -> None:
        """Nothing is sent but what the program sets."""

    def close(self) -> None:
        """The driver ends."""

    # -- opening and the safe state ---------------------------------------------------------------------

    async def _open(self) -> str:
        patience: float = self.binding.option("connect")
        if not await self._news.seen(lambda: bool(self._received), patience):
            if not self.binding.waives(NO_CONFIRMATION):
                others = self._unknown_ids()
                came = f" (other ids were: {others}; are those of the file right?)" if others else ""
                raise self.error(
                    f"none of the messages of its DBC file was heard at {self.binding.endpoint} within "
                    f"{patience:g} s{came}; check its power, the wires, the bit rate and the file",
                    timeout=True,
                )
            self.note("nothing was heard of it (waived by its binding)")
        self.publish(online=self._silence() <= self._patience, malformed=self._malformed)
        self._opened = True
        heard = sorted(name for name in self._received if "." not in name)
        return f"DBC device, heard {', '.join(heard) or 'nothing'}"

    def _touched(self) -> bool:
        """Opening only listens."""
        return False

    async def _make_safe(self, state: str) -> None:
        self._forget_setpoints()
        end = self.clock.monotonic() + SAFE_BY
        while True:
            start = self.clock.monotonic()
            for name in self._commands:
                await self._transmit(name, self._sent[name])
            if await self._news.seen(lambda since=start: self._confirmed(since), SAFE_AGAIN):  # type: ignore[misc]  # a default binds this round's start
                return
            if self.clock.monotonic() >= end:
                break
        raise self.error(f"its safe state is not confirmed: {self._why_not()}")

    def _forget_setpoints(self) -> None:
        """Commands carry the safe values, until something is set."""
        self._sent = {name: {} for name in self._commands}
        for term in self._safe:
            if term.message in self._sent:
                self._sent[term.message][term.signal] = term.value

    def _confirmed(self, since: float) -> bool:
        """Whether everything that confirms was received since then, and fits."""
        return all(self._fits(term, since) for term in self._confirm)

    def _fits(self, term: Term, since: float) -> bool:
        at, values = self._received.get(f"{term.message}.{term.signal}", (-math.inf, {}))
        return at > since and abs(values[term.signal] - term.value) <= term.within

    def _why_not(self) -> str:
        wrong = self._misfits(self.clock.monotonic() - self._patience)
        return ", ".join(wrong) or "what confirms it came too rarely"

    def _misfits(self, since: float) -> list[str]:
        """What should confirm the safe state and, as received since then, does not; one text each."""
        wrong = []
        for term in self._confirm:
            _, values = self._received.get(f"{term.message}.{term.signal}", (0.0, {}))
            if not self._fits(term, since):
                lacks = self._lacks(term.message, term.signal)
                unheard = f"absent ({self._problems[term.message][0]})" if lacks else "not heard"
                wrong.append(f"{term.message}.{term.signal} is {values.get(term.signal, unheard)}")
        return wrong

    def _moving(self) -> str:
        """A file says nothing of motion: it rests while what confirms its safe state is heard and fits."""
        if not self._confirm:
            return ""
        silence = self._silence()
        if silence > self._patience:
            return f"not heard for {silence:.1f} s"
        return ", ".join(self._misfits(-math.inf))

    # -- instructions -----------------------------------------------------------------------------------

    async def do_set(self, signal: str, value: float) -> None:
        """One signal; its message is sent with it."""
        message, name = self._named(signal)
        self._check_command(message)
        values = {**self._sent[message], **self._file.selectors(message, name), name: value}
        await self._transmit(message, values)
        self._sent[message] = values

    async def do_send(self, message: str, values: list[float]) -> None:
        """A whole message."""
        self._check_command(message)
        names = [signal.name for signal in self._file.message(message).signals]
        if len(values) != len(names):
            raise self.error(f"{message} has {len(names)} signals ({', '.join(names)}), not {len(values)}")
        named = dict(zip(names, values, strict=True))
        await self._transmit(message, named)
        self._sent[message] = named

    async def do_read(self, signal: str) -> float:
        """The last value, or the next one."""
        message, name = self._named(signal)
        oldest = self.clock.monotonic() - self._patience

        def fresh() -> bool:
            return self._received.get(f"{message}.{name}", (-math.inf,))[0] >= oldest

        if not await self._news.seen(fresh, self._patience):
            why = f": {self._problems[message][0]}" if self._lacks(message, name) else ""
            self.publish(online=self._silence() <= self._patience)
            raise self.error(f"{signal} was not received for over {self._patience:g} s{why}", timeout=True)
        return self._received[f"{message}.{name}"][1][name]

    def _lacks(self, message: str, signal: str) -> bool:
        """Whether the message comes, and without the signal."""
        at, values = self._received.get(message, (-math.inf, {}))
        young = at >= self.clock.monotonic() - self._patience
        return young and message in self._problems and signal not in values

    async def do_age_of(self, message: str) -> float:
        """Seconds since a message was received."""
        if message not in self._received:
            raise self.error(f"{message} was never received", timeout=True)
        return self.clock.monotonic() - self._received[message][0]

    # -- parts ------------------------------------------------------------------------------------------

    @property
    def _patience(self) -> float:
        max_age: float = self.binding.option("max_age")
        return max_age

    def _silence(self) -> float:
        """Seconds since the last message of any kind."""
        return self.clock.monotonic() - max((at for at, _ in self._received.values()), default=-math.inf)

    def _named(self, signal: str) -> tuple[str, str]:
        try:
            return self._file.split(signal)
        except DbcError as error:
            raise self.error(str(error)) from None

    def _check_command(self, message: str) -> None:
        if message not in self._commands:
            listed = f"only {', '.join(self._commands)}" if self._commands else "nothing"
            raise self.error(f"{message} may not be sent: the binding's 'commands' allow {listed}")

    async def _transmit(self, message: str, values: dict[str, float]) -> None:
        try:
            frame = self._file.encode(message, values)
        except DbcError as error:
            raise self.error(str(error)) from None
        await self._bus.send(frame)
