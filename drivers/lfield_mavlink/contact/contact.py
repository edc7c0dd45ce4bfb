"""Contact with one vehicle: its messages, commands with their refusals, and waiting for news."""

from __future__ import annotations

import asyncio
import math
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from lfield.driver import Clock, Device, DeviceBinding, Manifest, Reports
from lfield_mavlink.contact.exchange import Exchange, is_for_us
from lfield_mavlink.contact.state import Texts, VehicleState
from lfield_mavlink.geo import Place
from lfield_mavlink.link.dialect import dialect, result_words
from lfield_mavlink.link.station import station_of
from lfield_mavlink.modes import PX4_WORDS, STACKS, Profile

#: Seconds without any message after which the link is lost: a call must fail within 3 s.
LINK_LOST = 2.7
#: Seconds for a state to show after it was accepted. PX4 tells that it is armed once a second only, and on a
#: bad radio several in a row are lost.
SHOWS = 5.0
#: How often a command is sent in that time.
ATTEMPTS = 5
#: Seconds from the opening after which a vehicle that was not heard yet hears its station all the same.
UNHEARD = 3.0
#: Seconds to wait for a text that explains a refusal.
EXPLAINS = 0.3
#: Seconds for a state to show that the first copy of a command was taken, when the second was refused.
TAKEN = 1.5
#: What PX4 says of a mode that it does not enter although it has accepted it.
UNAVAILABLE = "Switching to {} is currently not available"

Handler = Callable[[Any], None]


class Contact(Device):
    """A vehicle that is heard and can be asked; what it can do is in its parts.

    They use `state`, `profile` and `texts` (what is known), `send` (a message), `on` and `expect` (messages),
    `command` and `achieve` (what must be accepted, and be seen), `exchange` (commands whose answer decides),
    `seen`, `until` and `next_news` (waiting), and the checks.
    """

    def __init__(
        self,
        binding: DeviceBinding,
        manifest: Manifest,
        clock: Clock,
        reports: Reports,
        send: Callable[[Any], None],
    ) -> None:
        super().__init__(binding, manifest, clock, reports)
        self.system: int = binding.option("system")
        #: The system id of this computer towards it, and why that is not this computer's alone ('': it is).
        self.station, self.not_alone = station_of(binding), ""
        #: Set while the owner is gone: nothing is asked for (see Driver.quiet).
        self.quiet = False
        #: Set while the vehicle is not heard.
        self.lost = False
        self._send = send
        self.state = VehicleState(binding.option("kind"))
        self._stack: str = binding.option("autopilot")
        self.exchange = Exchange(
            self.system, self.station, self.send, lambda: self.silence <= LINK_LOST, self._gate
        )
        self.texts = Texts()
        self._heard_at, self._opened_at = -math.inf, clock.monotonic()
        # Whether this computer has it: what was in use when it was found is nobody's until somebody acts.
        self._has_charge = False
        self._news = asyncio.Event()
        self._handlers: defaultdict[int, list[Handler]] = defaultdict(list)
        self._expected: dict[asyncio.Future[Any], Callable[[Any], bool]] = {}

    # -- what is known --------------------------------------------------------------------------------

    @property
    def profile(self) -> Profile:
        """What kind of vehicle it is; known once it is open."""
        if self.state.profile is None:
            raise self.error("it has not said what it is")
        return self.state.profile

    @property
    def silence(self) -> float:
        """Seconds since its autopilot said anything at all."""
        return self.clock.monotonic() - self._heard_at

    @property
    def unbeaten(self) -> float:
        """Seconds since its last heartbeat, whatever else it says."""
        return self.clock.monotonic() - (-math.inf if self.state.heard is None else self.state.heard)

    def send(self, message: Any) -> None:
        """Send it a message, which may be lost; none but questions before it is certain who is there."""
        if self._may_send(message):
            self._send(message)

    def _may_send(self, message: Any) -> bool:
        """Whether a message may go out now."""
        return True

    async def _gate(self, number: int) -> None:
        """Wait until a command may go out. Raises DeviceError."""

    def _reconnected(self, reason: str) -> None:
        """It is heard again after an interruption, and may be another vehicle."""

    def heard(self) -> None:
        """Its autopilot has said something, whatever that is, read or not."""
        if self.silence > LINK_LOST and self._heard_at > -math.inf:
            self._reconnected(f"{self.silence:.1f} s of silence")
        self._heard_at = self.clock.monotonic()
        super().heard()

    def reasons(self, start: float) -> str:
        """What the autopilot said from `start` on, to go after a reason."""
        return "".join(f", {text}" for text in self.texts.since(start))

    def check_link(self) -> None:
        """Raise DeviceError when the vehicle is not heard any more."""
        if self.silence > LINK_LOST:
            raise self.error(f"nothing heard for {self.silence:.1f} s; the link is lost", timeout=True)

    def take_charge(self) -> None:
        """From now on it is this computer's: heartbeats of its station keep its failsafe content."""
        self._has_charge = True

    @property
    def may_beat(self) -> bool:
        """Whether its station is to be heard.

        One that is armed when it is found was left by somebody: a guard that has died, perhaps. Until this
        computer commands it, its own failsafe must be able to act. A silent one may wait to be spoken to.
        """
        if self.state.heard is None:
            return self.clock.monotonic() - self._opened_at > UNHEARD
        self._has_charge = self._has_charge or not self.state.armed
        return self._has_charge

    def check_station(self, what: str) -> None:
        """Raise DeviceError when somebody else has the id of its station."""
        if self.not_alone:
            raise self.error(f"{what} refused: {self.not_alone}")

    @property
    def conflict(self) -> str:
        """Which other vehicle has its system id, '' when none has."""
        return ""

    async def check_alone(self) -> None:
        """Raise DeviceError when two vehicles have its system id."""

    def check_identity(self) -> None:
        """Raise DeviceError when it is another vehicle than the binding says."""
        state, kind = self.state, self.state.kind
        stack = STACKS.get(state.autopilot)
        if stack is None:
            raise self.error(
                f"system {self.system} has neither ArduPilot nor PX4 (MAV_AUTOPILOT {state.autopilot})"
            )
        if self._stack not in ("any", stack.lower()):
            raise self.error(f"system {self.system} has {stack}, not what the binding says: {self._stack}")
        if state.profile is None:
            raise self.error(f"a {kind} with {stack} is not served")
        if state.type not in state.profile.types:
            raise self.error(f"system {self.system} is no {kind} (MAV_TYPE {state.type})")
        self.exchange.px4 = state.profile.px4

    # -- messages -------------------------------------------------------------------------------------

    def on_message(self, message: Any) -> None:
        """A message of this vehicle's autopilot."""
        now = self.clock.monotonic()
        self.heard()
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_STATUSTEXT:
            self._on_text(message, now)
        values = self.state.update(message, now)
        if values:
            self.publish(**values)
        if is_for_us(message, self.station):
            self._hand_over(message)
        self._news.set()

    def _hand_over(self, message: Any) -> None:
        """To everybody who asked for it."""
        self.exchange.on_message(message)
        for handler in self._handlers.get(message.get_msgId(), ()):
            handler(message)
        for future, wanted in list(self._expected.items()):
            if not future.done() and wanted(message):
                future.set_result(message)

    def on(self, message_id: int, handler: Handler) -> None:
        """Call `handler` with every message of this id that is for us, from now on."""
        self._handlers[message_id].append(handler)

    def listens_to(self, message_id: int) -> bool:
        """Whether anybody has asked for messages of this id."""
        return message_id in self._handlers

    async def expect(self, wanted: Callable[[Any], bool], bound: float) -> Any | None:
        """The next message for us that is wanted; None when none came within `bound` seconds.

        Nothing is missed between a `send` and the `expect` right after it.
        """
        future: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._expected[future] = wanted
        try:
            async with asyncio.timeout(bound):
                return await future
        except TimeoutError:
            return None
        finally:
            del self._expected[future]

    def _on_text(self, message: Any, now: float) -> None:
        text = self.texts.add(message.text, message.id, message.chunk_seq, now)
        if text and message.severity <= dialect.MAV_SEVERITY_WARNING:
            self.note(f"the autopilot says: {text}")

    # -- asking and waiting ---------------------------------------------------------------------------

    async def command(
        self,
        what: str,
        number: int,
        *values: float | None,
        place: Place | None = None,
        once: bool = False,
        optional: bool = False,
        absent: str = "",
        taken: Callable[[], bool] | None = None,
    ) -> bool:
        """Have a command accepted. Raises DeviceError with the result and the autopilot's own reason.

        With `optional`, false when the autopilot does not know the command: there is another one to try.
        `absent` is what it may not have: PX4 says nothing to a command for what it has no driver of.

        `taken` is a state that shows that it was: when the first copy was taken and its answer lost, the
        second copy may be refused, as a takeoff is in the air. `once` is for what must not be done twice.
        """
        start = self.clock.monotonic()
        answer = await self.exchange.command(number, *values, place=place, once=once)
        if answer.result == dialect.MAV_RESULT_ACCEPTED:
            return True
        if answer.attempts > 1 and taken is not None and await self.seen(taken, TAKEN):
            return True
        if optional and answer.result == dialect.MAV_RESULT_UNSUPPORTED:
            return False
        if answer.result is None:
            why = f": it has no {absent} that it knows of" if absent and self.exchange.px4 else ""
            perhaps = "; it may have been done all the same" if once else ""
            raise self.error(f"{what}: the autopilot did not answer{why}{perhaps}", timeout=True)
        await self._hear_reasons(start)
        raise self.error(f"{what} refused: {result_words(answer.result)}{self.reasons(start)}")

    async def _hear_reasons(self, start: float) -> None:
        """Wait for a text from `start` on. PX4 sends none while it hears no ground station."""
        if not (self.quiet and self.exchange.px4):
            await self.seen(lambda: bool(self.texts.since(start)), EXPLAINS)

    async def achieve(
        self, what: str, state: Callable[[], bool], number: int, *values: float | None, mode: str = ""
    ) -> None:
        """Have a command accepted and wait until the state shows it. Raises DeviceError.

        It is sent again while the state does not show it: the acceptance may have been a late one of an
        earlier command. So it must be one that may be carried out twice. `mode` is the one that it leads to,
        if any.
        """
        start = self.clock.monotonic()
        for _ in range(ATTEMPTS):
            await self.command(what, number, *values, taken=state)
            if await self.seen(state, SHOWS / ATTEMPTS):
                return
            # Not before: the words may be late ones about an earlier attempt.
            if self.is_unavailable(mode, start):
                raise self.error(f"{what} refused{self.reasons(start)}")
        self.check_link()
        shown = f"did not happen within {SHOWS:g} s"
        if self.unbeaten > SHOWS / 2:
            shown = f"it cannot be seen: no heartbeat for {self.unbeaten:.1f} s, which would tell it"
        raise self.error(f"{what} was accepted but {shown}{self.reasons(start)}")

    def is_unavailable(self, mode: str, start: float) -> bool:
        """Whether PX4 has said since `start` that it does not enter this mode, which it has accepted."""
        refusals = {UNAVAILABLE.format(name) for name in PX4_WORDS.get(mode, ())}
        return not refusals.isdisjoint(self.texts.since(start))

    async def until(self, condition: Callable[[], bool], bound: float, what: str) -> None:
        """Wait until the state shows it. Raises DeviceError when it does not."""
        start = self.clock.monotonic()
        if not await self.seen(condition, bound):
            self.check_link()
            raise self.error(f"{what} did not happen within {bound:g} s{self.reasons(start)}")

    async def seen(self, condition: Callable[[], bool], bound: float) -> bool:
        """Whether the condition came true within `bound` seconds; looked at with every message."""
        end = self.clock.monotonic() + bound
        while not condition():
            left = end - self.clock.monotonic()
            if left <= 0.0:
                return False
            await self.next_news(left)
        return True

    async def next_news(self, longest: float) -> None:
        """Sleep until the next message, at most `longest` seconds."""
        self._news.clear()
        try:
            async with asyncio.timeout(longest):
                await self._news.wait()
        except TimeoutError:
            pass
