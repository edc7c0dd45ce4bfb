"""Contact with one vehicle: messages, commands with their refusals, and waiting for states."""

from __future__ import annotations

import asyncio
import math
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from lfield.driver import Clock, Device, DeviceBinding, Manifest, Reports
from lfield_mavlink import log_messages
from lfield_mavlink.contact.components import Components
from lfield_mavlink.contact.exchange import Exchange, is_for_us
from lfield_mavlink.contact.vehicle_state import Texts, VehicleState
from lfield_mavlink.geodesy import Place
from lfield_mavlink.link.dialect import AUTOPILOT, dialect, result_text
from lfield_mavlink.modes import PX4_MODE_TEXTS, STACKS, Profile
from lfield_mavlink.station_ids import station_of

#: Seconds without a message after which the link is lost: a call must fail within 3 s.
LINK_LOST = 2.7
#: Seconds until a state is reported after its command was accepted. PX4 reports arming only once a second,
#: and on a bad radio several reports in a row are lost.
STATE_TIMEOUT = 5.0
#: Transmissions of a command in that time.
ATTEMPTS = 5
#: Seconds after opening from which heartbeats are sent to a vehicle that has not sent anything.
FIRST_CONTACT_GRACE = 3.0
#: Seconds to wait for a text that explains a refusal.
REASON_TIMEOUT = 0.3
#: Seconds for a state that shows that the first copy of a command was executed although the second was
#: refused.
COPY_ACCEPTED_TIMEOUT = 1.5
#: Text of PX4 for a mode that it accepted but does not enter.
UNAVAILABLE = "Switching to {} is currently not available"

Handler = Callable[[Any], None]


class Contact(Device):
    """Communication with one vehicle; its abilities are in its parts.

    The parts use `state`, `profile` and `texts` (known facts), `send` (a message), `on` and `expect`
    (messages), `command` and `achieve` (must be accepted, and confirmed by the state), `exchange` (commands
    decided by their answer), `wait_for`, `until` and `wait_message` (waiting), and the checks.
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
        #: Our system id towards this vehicle, and the reason why it is not unique ('': it is).
        self.station, self.station_conflict = station_of(binding), ""
        #: Set while the host is silent: no requests are sent (see Driver.quiet).
        self.is_quiet = False
        #: Set while the link is lost.
        self.lost = False
        self._send = send
        self.state = VehicleState(binding.option("kind"))
        self._stack: str = binding.option("autopilot")
        self.exchange = Exchange(
            self.system, self.station, self.send, lambda: self.silence <= LINK_LOST, self._gate
        )
        self.texts, self.components = Texts(), Components(clock.monotonic)
        self._last_contact, self._opened_at = -math.inf, clock.monotonic()
        # Whether this computer is in control: a vehicle that was in use when it was opened is not, until a
        # command.
        self._has_control = False
        self._changed = asyncio.Event()
        self._handlers: defaultdict[int, list[Handler]] = defaultdict(list)
        self._expected: dict[asyncio.Future[Any], Callable[[Any], bool]] = {}

    # -- state ----------------------------------------------------------------------------------------

    @property
    def profile(self) -> Profile:
        """The autopilot and kind of the vehicle; known once the vehicle is open."""
        if self.state.profile is None:
            raise self.error("the profile is known once the vehicle is open")
        return self.state.profile

    @property
    def silence(self) -> float:
        """Seconds since the autopilot sent any message."""
        return self.clock.monotonic() - self._last_contact

    @property
    def heartbeat_age(self) -> float:
        """Seconds since the last heartbeat of the autopilot."""
        return self.clock.monotonic() - (
            -math.inf if self.state.heartbeat_at is None else self.state.heartbeat_at
        )

    def send(self, message: Any) -> None:
        """Sends a message, which may be lost; only queries until the vehicle's identity is certain."""
        if self._may_send(message):
            self._send(message)

    def _may_send(self, message: Any) -> bool:
        """Whether a message may be sent now."""
        return True

    async def _gate(self, number: int) -> None:
        """Waits until a command may be sent. Raises DeviceError."""

    def _reconnected(self, reason: str) -> None:
        """Handles the end of an interruption: the vehicle may be another one."""

    def heard(self) -> None:
        """Records a message of any kind from the autopilot."""
        if self.silence > LINK_LOST and self._last_contact > -math.inf:
            self._reconnected(f"{self.silence:.1f} s of silence")
        self._last_contact = self.clock.monotonic()
        super().heard()

    def reasons(self, start: float) -> str:
        """The texts of the autopilot since `start`, to be appended to a reason."""
        return "".join(f", {text}" for text in self.texts.since(start))

    def check_link(self) -> None:
        """Raises DeviceError when the link is lost."""
        if self.silence > LINK_LOST:
            raise self.error(f"no message for {self.silence:.1f} s; the link is lost", timeout=True)

    def assume_control(self) -> None:
        """Takes control: station heartbeats prevent the ground station failsafe from now on."""
        self._has_control = True

    @property
    def may_send_heartbeat(self) -> bool:
        """Whether station heartbeats may be sent.

        A vehicle that is armed when it is opened may have lost its guard: until this computer commands it,
        its own failsafe must be able to act. A silent one may wait for a station's heartbeat.
        """
        if self.state.heartbeat_at is None:
            return self.clock.monotonic() - self._opened_at > FIRST_CONTACT_GRACE
        self._has_control = self._has_control or not self.state.armed
        return self._has_control

    def set_quiet(self, is_quiet: bool) -> None:
        """Stops or resumes requests: without them the autopilot's own failsafe can start."""
        self.is_quiet = is_quiet

    def report_station_conflict(self, reason: str) -> None:
        """Logs that another sender has the id of the station; motion commands are refused from now on."""
        self.station_conflict = reason
        self.note(log_messages.STATION_CONFLICT.line(reason=reason))

    def check_station(self, action: str) -> None:
        """Raises DeviceError when another station has the same id."""
        if self.station_conflict:
            raise self.error(f"{action} refused: {self.station_conflict}")

    @property
    def conflict(self) -> str:
        """Describes the other vehicle with its system id, '' without one."""
        return ""

    async def check_alone(self) -> None:
        """Raises DeviceError when two vehicles have this system id."""

    def check_identity(self) -> None:
        """Raises DeviceError when the vehicle does not match the binding."""
        state, kind = self.state, self.state.kind
        stack = STACKS.get(state.autopilot)
        if stack is None:
            raise self.error(
                f"system {self.system} has neither ArduPilot nor PX4 (MAV_AUTOPILOT {state.autopilot})"
            )
        if self._stack not in ("any", stack.lower()):
            raise self.error(f"system {self.system} has {stack}, but the binding has {self._stack}")
        if state.profile is None:
            raise self.error(f"a {kind} with {stack} is not supported")
        if state.type not in state.profile.types:
            raise self.error(f"system {self.system} is not a {kind} (MAV_TYPE {state.type})")
        self.exchange.set_stack(px4=state.profile.px4)

    # -- messages -------------------------------------------------------------------------------------

    def on_message(self, message: Any) -> None:
        """Handles a message of this vehicle's autopilot."""
        now = self.clock.monotonic()
        self.heard()
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_STATUSTEXT:
            self._on_text(message, now)
        values = self.state.update(message, now)
        if values:
            self.publish(**values)
        if is_for_us(message, self.station):
            self._dispatch(message)
        self._changed.set()

    def on_component(self, message: Any) -> None:
        """Handles a message of a camera or gimbal with the vehicle's system id."""
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self.components.on_heartbeat(message.get_srcComponent())
        elif is_for_us(message, self.station):
            self._dispatch(message)
        self._changed.set()

    def _dispatch(self, message: Any) -> None:
        """Passes a message to every handler."""
        self.exchange.on_message(message)
        for handler in self._handlers.get(message.get_msgId(), ()):
            handler(message)
        for future, is_expected in list(self._expected.items()):
            if not future.done() and is_expected(message):
                future.set_result(message)

    def on(self, message_id: int, handler: Handler) -> None:
        """Calls `handler` for every message of this id that is addressed to us."""
        self._handlers[message_id].append(handler)

    def listens_to(self, message_id: int) -> bool:
        """Whether a message id has a handler."""
        return message_id in self._handlers

    async def expect(self, accepts: Callable[[Any], bool], timeout: float) -> Any | None:
        """The next matching message for us; None after `timeout` seconds.

        Responses right after a `send` are not missed.
        """
        future: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._expected[future] = accepts
        try:
            async with asyncio.timeout(timeout):
                return await future
        except TimeoutError:
            return None
        finally:
            del self._expected[future]

    def _on_text(self, message: Any, now: float) -> None:
        text = self.texts.add(message.text, message.id, message.chunk_seq, now)
        if text and message.severity <= dialect.MAV_SEVERITY_WARNING:
            self.note(log_messages.AUTOPILOT_TEXT.line(text=text))

    # -- commands and waiting -------------------------------------------------------------------------

    async def command(
        self,
        action: str,
        number: int,
        *values: float | None,
        place: Place | None = None,
        once: bool = False,
        optional: bool = False,
        component: str = "",
        is_accepted: Callable[[], bool] | None = None,
        target: int = AUTOPILOT,
    ) -> bool:
        """Sends a command until it is accepted. Raises DeviceError with the result and the autopilot's
        reason.

        With `optional`, returns False when the autopilot does not know the command. `component` names a part
        that it may lack: PX4 does not answer a command for a missing driver.

        `is_accepted` is a state that shows acceptance: if the first answer was lost, the second copy may be
        refused, such as a takeoff in the air. `once` is for commands that must not be executed twice.
        `target` is the addressed component.
        """
        start = self.clock.monotonic()
        answer = await self.exchange.command(number, *values, place=place, once=once, target=target)
        if answer.result == dialect.MAV_RESULT_ACCEPTED:
            return True
        if (
            answer.attempts > 1
            and is_accepted is not None
            and await self.wait_for(is_accepted, COPY_ACCEPTED_TIMEOUT)
        ):
            return True
        if optional and answer.result == dialect.MAV_RESULT_UNSUPPORTED:
            return False
        if answer.result is None:
            hint = f": it may have no {component}" if component and self.exchange.px4 else ""
            warning = "; it may have been executed" if once else ""
            raise self.error(f"{action}: the autopilot did not answer{hint}{warning}", timeout=True)
        await self._await_reasons(start)
        raise self.error(f"{action} refused: {result_text(answer.result)}{self.reasons(start)}")

    async def _await_reasons(self, start: float) -> None:
        """Waits for a text since `start`. PX4 sends none while it receives no station heartbeats."""
        if not (self.is_quiet and self.exchange.px4):
            await self.wait_for(lambda: bool(self.texts.since(start)), REASON_TIMEOUT)

    async def achieve(
        self, action: str, state: Callable[[], bool], number: int, *values: float | None, mode: str = ""
    ) -> None:
        """Sends a command until it is accepted, and waits until the state confirms it. Raises DeviceError.

        Repeated while the state does not confirm it, since the acceptance may be a late one of an earlier
        command: it must be idempotent. `mode` is the resulting mode, if any.
        """
        start = self.clock.monotonic()
        for _ in range(ATTEMPTS):
            await self.command(action, number, *values, is_accepted=state)
            if await self.wait_for(state, STATE_TIMEOUT / ATTEMPTS):
                return
            # Checked here, not earlier: the text may belong to an earlier attempt.
            if self.is_unavailable(mode, start):
                raise self.error(f"{action} refused{self.reasons(start)}")
        self.check_link()
        problem = f"did not happen within {STATE_TIMEOUT:g} s"
        if self.heartbeat_age > STATE_TIMEOUT / 2:
            problem = f"it cannot be confirmed: no heartbeat for {self.heartbeat_age:.1f} s"
        raise self.error(f"{action} was accepted but {problem}{self.reasons(start)}")

    def is_unavailable(self, mode: str, start: float) -> bool:
        """Whether PX4 has reported since `start` that it does not enter this mode, which it had accepted."""
        refusals = {UNAVAILABLE.format(name) for name in PX4_MODE_TEXTS.get(mode, ())}
        return not refusals.isdisjoint(self.texts.since(start))

    async def until(self, condition: Callable[[], bool], timeout: float, action: str) -> None:
        """Waits for a state. Raises DeviceError."""
        start = self.clock.monotonic()
        if not await self.wait_for(condition, timeout):
            self.check_link()
            raise self.error(f"{action} did not happen within {timeout:g} s{self.reasons(start)}")

    async def wait_for(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Whether the condition became true within `timeout` seconds; evaluated with every message."""
        end = self.clock.monotonic() + timeout
        while not condition():
            remaining = end - self.clock.monotonic()
            if remaining <= 0.0:
                return False
            await self.wait_message(remaining)
        return True

    async def wait_message(self, longest: float) -> None:
        """Waits for the next message, at most `longest` seconds."""
        self._changed.clear()
        try:
            async with asyncio.timeout(longest):
                await self._changed.wait()
        except TimeoutError:
            pass
