"""Whether a vehicle could be armed now, why not, and waiting for it.

By the bit for the checks before arming in SYS_STATUS, and a position. Neither a GPS fix nor a home nor a
position alone is readiness: ArduPilot has them up to 32 s before it can be armed. Nor is the bit alone, since
ArduPilot's checks are those of the mode that it is in, and STABILIZE needs no position.
"""

from __future__ import annotations

import math
from contextlib import suppress

from lfield.driver import DeviceError
from lfield_mavlink.contact.contact import LINK_LOST, Contact
from lfield_mavlink.contact.state import PREARM, VehicleState
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.parts.motion import Motion

#: How the autopilots begin a text that says why they cannot be armed.
COMPLAINTS = ("PreArm: ", "Preflight Fail: ", "Arm: ", "Arming denied: ")
#: What is said when it says nothing.
FAILED = "its checks before arming have not passed"
#: Seconds for which such a text counts; ArduPilot says each again every 30 s.
SAID = 35.0
#: Seconds to wait for the autopilot to say it, once it was asked to.
SPEAKS = 1.2
#: Seconds after which it is not known any more what SYS_STATUS and a position told.
CHECKS_OLD = 3.0
#: Seconds after a change of mode until the checks are those of the new one, and the bit has been told again.
SETTLES = 2.0
#: Seconds between two looks, and between two attempts to be in the mode to be armed in.
LOOK, AGAIN = 0.5, 3.0
#: Seconds after which a wait is logged: beyond those that a change of mode takes.
LONG = SETTLES + 1.0


class Readiness:
    """The checks before arming."""

    def __init__(self, vehicle: Contact, motion: Motion) -> None:
        self._vehicle, self._state, self._motion = vehicle, vehicle.state, motion
        # What was told before it was brought into another mode says nothing.
        self._counts_from = -math.inf

    async def do_is_ready(self) -> bool:
        """Whether it could be armed now, or is armed."""
        return not self._lack()

    async def do_why_not_ready(self) -> str:
        """Why it could not be armed now, in the autopilot's words where it has any; '' when it could."""
        lack = self._lack()
        return await self._words(lack) if lack else ""

    async def do_wait_ready(self, seconds: float) -> None:
        """Wait until it can be armed, in the mode for that. Raises DeviceError with the reason if not."""
        vehicle = self._vehicle
        if not 0.0 <= seconds < math.inf:
            raise vehicle.error(f"waitReady needs seconds from 0 on, not {seconds:g}")
        start = vehicle.clock.monotonic()
        moded_at, noted = -math.inf, False
        self._counts_from = -math.inf
        while lack := self._lack() or self._elsewhere():
            now = vehicle.clock.monotonic()
            if now - start >= seconds:
                raise await self._gave_up(seconds, lack)
            if now - start >= LONG and not noted:
                vehicle.note(f"waiting until it can be armed: {lack}")
                noted = True
            if self._is_in_another_mode and now - moded_at >= AGAIN:
                await self._enter_mode()
                moded_at = vehicle.clock.monotonic()
                self._counts_from = moded_at + SETTLES
            await vehicle.seen(
                lambda: not (self._lack() or self._elsewhere()), min(LOOK, start + seconds - now)
            )

    async def _words(self, lack: str) -> str:
        """What the autopilot says against arming, when it is asked to say it; else what it lacks."""
        vehicle, now = self._vehicle, self._vehicle.clock.monotonic()
        # PX4 sends no texts while it hears no ground station, and nothing is asked for then.
        if not vehicle.quiet and vehicle.silence <= LINK_LOST:
            await vehicle.exchange.command(dialect.MAV_CMD_RUN_PREARM_CHECKS)
            # Several come at once: those after the first are waited for too.
            await vehicle.seen(lambda: bool(self._said(now)), SPEAKS)
            await vehicle.seen(lambda: False, 0.2 * SPEAKS)
        earlier = self._said(now - SAID) if lack.startswith(FAILED) else ""
        unsaid = "; ".join(filter(None, dict.fromkeys((lack, self._elsewhere()))))
        return self._said(now) or earlier or unsaid

    def _said(self, since: float) -> str:
        texts = (text for text in self._vehicle.texts.since(since) if text.startswith(COMPLAINTS))
        return "; ".join(dict.fromkeys(texts))

    def _lack(self) -> str:
        """What is missing, '' when nothing is."""
        if crashed := self._motion.monitor.crashed:
            return f"it crashed, and must be inspected: {crashed}"
        if self._vehicle.silence > LINK_LOST:
            return f"nothing heard for {self._vehicle.silence:.1f} s"
        if self._vehicle.conflict and not self._state.armed:
            return self._vehicle.conflict
        since = max(self._counts_from, self._vehicle.clock.monotonic() - CHECKS_OLD)
        return lack(self._state, since, px4=self._vehicle.profile.px4)

    def _elsewhere(self) -> str:
        """What its checks do not say while ArduPilot is in another mode than it is armed in, '' when they do.

        A rover's pass in MANUAL 20 s before it can be armed in GUIDED.
        """
        profile, mode = self._vehicle.profile, self._state.mode
        if profile.px4 or not self._is_in_another_mode:
            return ""
        return f"its checks before arming are those of {mode}, and it is armed in {profile.arming}"

    @property
    def _is_in_another_mode(self) -> bool:
        """Whether it is not in the mode to be armed in; a pilot's while its motors are on."""
        return not self._state.armed and self._state.mode != self._vehicle.profile.arming

    async def _enter_mode(self) -> None:
        """One that refuses is asked again: an autopilot that starts takes what it was told back."""
        with suppress(DeviceError):
            await self._motion.set_mode(self._vehicle.profile.arming)

    async def _gave_up(self, seconds: float, lack: str) -> DeviceError:
        why = await self._words(lack)
        return self._vehicle.error(f"waitReady: it cannot be armed after {seconds:g} s: {why}")


def lack(state: VehicleState, since: float, *, px4: bool) -> str:
    """What a vehicle lacks to be armed, as far as it has told from `since` on; '' when nothing. Pure."""
    if state.armed:
        return ""
    sensors = state.sensors
    if sensors is None or sensors.at < since:
        return "it has not told whether its checks before arming have passed"
    if state.critical:
        return "its failsafe is on"
    # PX4 has the bit in its health only, ArduPilot neither where nothing is checked.
    checked = px4 or bool(sensors.present & sensors.enabled & PREARM)
    if checked and not sensors.healthy & PREARM:
        unhealthy = ", ".join(sensors.unhealthy)
        return FAILED + (f"; not well: {unhealthy}" if unhealthy else "")
    if state.placed_at < since:
        return "it has told no position"
    return ""
