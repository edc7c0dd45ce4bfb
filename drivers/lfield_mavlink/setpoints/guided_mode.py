"""How the mode of setpoints is entered: GUIDED of ArduPilot, OFFBOARD of PX4; how a copter hovers in it."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress

from lfield.driver import DeviceError
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.link.dialect import dialect, result_words

#: Seconds of setpoints that PX4 must have noticed before it is told to enter OFFBOARD.
NOTICES = 0.15
#: Seconds for an answer, and for the mode to show, before it is told again; and how often PX4 may refuse.
SHOWN, REFUSALS = 0.05, 2
#: Seconds after its acceptance, asked again meanwhile, after which it would have said that it does not.
BELIEVED = 0.1


class GuidedMode:
    """The mode of setpoints of one vehicle."""

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle, self._state = vehicle, vehicle.state
        #: Whether PX4 has accepted OFFBOARD and has told no mode since.
        self.is_believed = False
        vehicle.on(dialect.MAVLINK_MSG_ID_HEARTBEAT, self._on_mode)
        vehicle.on(dialect.MAVLINK_MSG_ID_CURRENT_MODE, self._on_mode)

    def _on_mode(self, _: object) -> None:
        self.is_believed = False

    @property
    def is_entered(self) -> bool:
        """Whether the vehicle is in it, as far as it has told."""
        return self._state.mode == self._vehicle.profile.guided

    async def enter_guided(self, until: float) -> bool:
        """ArduPilot has entered GUIDED when it acknowledges that: this counts, or its heartbeat, if sooner.

        Any of these packets may be lost, so it is asked again soon. False when it refuses, or leaves all of
        them without an answer until `until`: then it is to be asked as for any other mode, for the reason.
        """
        result = None
        while result is None and not self.is_entered:
            if self._vehicle.clock.monotonic() >= until:
                break
            result = await self._ask()
        if result == dialect.MAV_RESULT_ACCEPTED:
            self._state.enters(self._vehicle.profile.guided)
        return self.is_entered

    async def enter_offboard(self, what: str, until: float, within: str) -> None:
        """PX4 enters OFFBOARD when it has noticed the setpoints, and shows it by CURRENT_MODE.

        What it does not enter it accepts all the same, and says so in words at once. CURRENT_MODE comes when
        the mode changes and then after half a second: when that packet was lost, no such words are enough.
        `within` is the time until `until` in words. Raises DeviceError.
        """
        vehicle, guided = self._vehicle, self._vehicle.profile.guided
        start, pause, refusals, accepted = vehicle.clock.monotonic(), NOTICES, 0, math.inf
        while not await vehicle.seen(lambda: self.is_entered, pause):
            asked = vehicle.clock.monotonic()
            if asked >= min(accepted + BELIEVED, max(accepted, until)):
                self.is_believed = True
                break
            result = await self._ask_for_offboard(asked)
            refused = vehicle.is_unavailable(guided, asked) or result not in (
                None,
                dialect.MAV_RESULT_ACCEPTED,
            )
            # The first time it may be that the setpoints were lost.
            pause, refusals = (NOTICES, refusals + 1) if refused else (0.0, refusals)
            if refused:
                accepted = math.inf
            elif result is not None:
                accepted = min(accepted, vehicle.clock.monotonic())
            over = vehicle.clock.monotonic() >= until and accepted == math.inf
            if not self.is_entered and (over or refusals == REFUSALS):
                vehicle.check_link()
                why = "refused" if refused else f"not entered within {within}"
                words = "no answer" if result is None else result_words(result)
                raise vehicle.error(f"{what}: {guided} was {why}: {words}{vehicle.reasons(start)}")

    async def _ask_for_offboard(self, asked: float) -> int | None:
        """Tell PX4 once, and wait a moment for what becomes of it; the result of the command."""
        vehicle, guided = self._vehicle, self._vehicle.profile.guided
        result = await self._ask()
        if result is not None:
            await vehicle.seen(lambda: self.is_entered or vehicle.is_unavailable(guided, asked), SHOWN)
        return result

    async def _ask(self) -> int | None:
        """Tell it once to enter the mode; the result, None when none has come soon."""
        profile, command = self._vehicle.profile, dialect.MAV_CMD_DO_SET_MODE
        values = profile.mode_command(profile.guided)
        answer = await self._vehicle.exchange.command(command, *values, once=True, patience=SHOWN)
        return answer.result


#: m/s below which a copter has stopped, and the seconds within which it must.
STOPPED, WITHIN = 0.4, 10.0


class Hover:
    """A copter of ArduPilot that was told to stop, in BRAKE, hovers on in GUIDED.

    In BRAKE its failsafe for the ground station would not act when this computer is dead: with bit 4 of
    FS_OPTIONS, which is the default, that goes on in all modes of a pilot, and BRAKE is one of them
    (Copter::failsafe_gcs_on_event and Mode::is_autopilot of ArduCopter 4.7).
    """

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle, self._state = vehicle, vehicle.state
        self._asked = asyncio.Event()
        self._work: asyncio.Task[None] | None = None

    def begin(self) -> None:
        """It has been told to stop; where BRAKE is its safe state it stays in that."""
        profile, binding = self._vehicle.profile, self._vehicle.binding
        if profile.kind == "copter" and not profile.px4 and profile.hold != profile.safe(binding.safe_state):
            self._asked.set()

    def end(self) -> None:
        """It is told something else."""
        self._asked.clear()
        if self._work is not None:
            self._work.cancel()

    async def keep(self) -> None:
        """Do what was begun, until cancelled."""
        while True:
            await self._asked.wait()
            self._asked.clear()
            self._work = asyncio.ensure_future(self._hover())
            try:
                await asyncio.wait([self._work])
            finally:
                self._work.cancel()

    async def _hover(self) -> None:
        vehicle, profile = self._vehicle, self._vehicle.profile
        await vehicle.seen(lambda: not self._stops or self._has_stopped, WITHIN)
        if self._stops and self._has_stopped:
            mode, values = profile.guided, profile.mode_command(profile.guided)
            set_mode = dialect.MAV_CMD_DO_SET_MODE
            with suppress(DeviceError):
                await vehicle.achieve("hold", lambda: self._state.mode == mode, set_mode, *values, mode=mode)

    @property
    def _stops(self) -> bool:
        return self._state.armed and self._state.mode == self._vehicle.profile.hold

    @property
    def _has_stopped(self) -> bool:
        return math.hypot(*self._state.velocity) < STOPPED
