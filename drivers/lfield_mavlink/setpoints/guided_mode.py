"""Entering the mode for setpoints: ArduPilot's GUIDED, PX4's OFFBOARD; hovering of a copter in it."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress

from lfield.driver import DeviceError
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.link.dialect import dialect, result_text

#: Seconds of setpoints that PX4 needs before OFFBOARD is commanded.
SETPOINT_LEAD = 0.15
#: Seconds for an answer, and for the mode, before a repetition; number of refusals of PX4.
ANSWER_TIMEOUT, REFUSALS = 0.05, 2
#: Seconds after a repeated acceptance of PX4 after which a refusal would have arrived.
ASSUMPTION_TIME = 0.1


class GuidedMode:
    """The mode for setpoints of one vehicle."""

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle, self._state = vehicle, vehicle.state
        #: Whether PX4 has accepted OFFBOARD and has reported no mode since.
        self.is_assumed = False
        vehicle.on(dialect.MAVLINK_MSG_ID_HEARTBEAT, self._on_mode)
        vehicle.on(dialect.MAVLINK_MSG_ID_CURRENT_MODE, self._on_mode)

    def _on_mode(self, _: object) -> None:
        self.is_assumed = False

    @property
    def is_entered(self) -> bool:
        """Whether the vehicle has reported the mode."""
        return self._state.mode == self._vehicle.profile.guided

    async def enter_guided(self, until: float) -> bool:
        """Enters GUIDED, as confirmed by ArduPilot's acknowledgement or its heartbeat.

        Repeated soon, since packets may be lost. False when it is refused, or unanswered until `until`: then
        the caller uses the ordinary command to get the reason.
        """
        result = None
        while result is None and not self.is_entered:
            if self._vehicle.clock.monotonic() >= until:
                break
            result = await self._request_mode()
        if result == dialect.MAV_RESULT_ACCEPTED:
            self._state.on_mode_entered(self._vehicle.profile.guided)
        return self.is_entered

    async def enter_offboard(self, action: str, until: float, duration: str) -> None:
        """Enters OFFBOARD: PX4 needs setpoints first, and confirms it by CURRENT_MODE.

        PX4 accepts the command in any case, and reports a failure by a text at once. CURRENT_MODE comes at
        the change of mode and then after half a second; if it was lost, the absence of such a text is
        sufficient. `duration` is the time until `until` in words. Raises DeviceError.
        """
        vehicle, guided = self._vehicle, self._vehicle.profile.guided
        start, pause, refusals, accepted_at = vehicle.clock.monotonic(), SETPOINT_LEAD, 0, math.inf
        while not await vehicle.wait_for(lambda: self.is_entered, pause):
            requested_at = vehicle.clock.monotonic()
            if requested_at >= min(accepted_at + ASSUMPTION_TIME, max(accepted_at, until)):
                self.is_assumed = True
                break
            result = await self._request_offboard(requested_at)
            is_refused = vehicle.is_unavailable(guided, requested_at) or result not in (
                None,
                dialect.MAV_RESULT_ACCEPTED,
            )
            # A first refusal may mean that the setpoints were lost.
            pause, refusals = (SETPOINT_LEAD, refusals + 1) if is_refused else (0.0, refusals)
            if is_refused:
                accepted_at = math.inf
            elif result is not None:
                accepted_at = min(accepted_at, vehicle.clock.monotonic())
            has_timed_out = vehicle.clock.monotonic() >= until and accepted_at == math.inf
            if not self.is_entered and (has_timed_out or refusals == REFUSALS):
                vehicle.check_link()
                problem = "refused" if is_refused else f"not entered within {duration}"
                answer = "no answer" if result is None else result_text(result)
                raise vehicle.error(f"{action}: {guided} was {problem}: {answer}{vehicle.reasons(start)}")

    async def _request_offboard(self, requested_at: float) -> int | None:
        """Commands OFFBOARD once and waits briefly for the effect; returns the result."""
        vehicle, guided = self._vehicle, self._vehicle.profile.guided
        result = await self._request_mode()
        if result is not None:
            await vehicle.wait_for(
                lambda: self.is_entered or vehicle.is_unavailable(guided, requested_at), ANSWER_TIMEOUT
            )
        return result

    async def _request_mode(self) -> int | None:
        """Commands the mode once; returns the result, None without a timely one."""
        profile, command = self._vehicle.profile, dialect.MAV_CMD_DO_SET_MODE
        values = profile.mode_command(profile.guided)
        answer = await self._vehicle.exchange.command(
            command, *values, once=True, answer_timeout=ANSWER_TIMEOUT
        )
        return answer.result


#: m/s below which a copter has stopped, and the seconds within which it must.
STOPPED, WITHIN = 0.4, 10.0


class Hover:
    """Moves a stopped ArduCopter from BRAKE to a hover in GUIDED.

    Its ground station failsafe would not act in BRAKE when this computer fails: with bit 4 of FS_OPTIONS
    (default) it is ignored in pilot modes, and BRAKE is one (Copter::failsafe_gcs_on_event and
    Mode::is_autopilot of ArduCopter 4.7).
    """

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle, self._state = vehicle, vehicle.state
        self._requested = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Starts a hover after the copter was commanded to stop, unless BRAKE is its safe state."""
        profile, binding = self._vehicle.profile, self._vehicle.binding
        if profile.kind == "copter" and not profile.px4 and profile.hold != profile.safe(binding.safe_state):
            self._requested.set()

    def end(self) -> None:
        """Ends the hover because of another command."""
        self._requested.clear()
        if self._task is not None:
            self._task.cancel()

    async def run(self) -> None:
        """Completes stops until cancelled."""
        while True:
            await self._requested.wait()
            self._requested.clear()
            self._task = asyncio.ensure_future(self._hover())
            try:
                await asyncio.wait([self._task])
            finally:
                self._task.cancel()

    async def _hover(self) -> None:
        vehicle, profile = self._vehicle, self._vehicle.profile
        await vehicle.wait_for(lambda: not self._is_stopping or self._has_stopped, WITHIN)
        if self._is_stopping and self._has_stopped:
            mode, values = profile.guided, profile.mode_command(profile.guided)
            set_mode = dialect.MAV_CMD_DO_SET_MODE
            with suppress(DeviceError):
                await vehicle.achieve("hold", lambda: self._state.mode == mode, set_mode, *values, mode=mode)

    @property
    def _is_stopping(self) -> bool:
        return self._state.armed and self._state.mode == self._vehicle.profile.hold

    @property
    def _has_stopped(self) -> bool:
        return math.hypot(*self._state.velocity) < STOPPED
