"""Whether a vehicle can be armed, the reasons against it, and waiting for it.

Uses the pre-arm bit in SYS_STATUS and a position. A GNSS fix, a home or a position alone are not sufficient:
ArduPilot has them up to 32 s before it can be armed. Nor is the bit alone, since ArduPilot's checks are those
of its present mode, and STABILIZE needs no position.
"""

from __future__ import annotations

import math
from contextlib import suppress

from lfield.driver import DeviceError
from lfield_mavlink import log_messages
from lfield_mavlink.contact.contact import LINK_LOST, Contact
from lfield_mavlink.contact.vehicle_state import PREARM, VehicleState
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.parts.motion_control import Motion

#: Prefixes of texts with reasons against arming.
COMPLAINTS = ("PreArm: ", "Preflight Fail: ", "Arm: ", "Arming denied: ")
#: The reason if there is no text.
FAILED = "the pre-arm checks have failed"
#: Seconds for which such a text is valid; ArduPilot repeats each every 30 s.
TEXT_MAX_AGE = 35.0
#: Seconds to wait for a requested text.
TEXT_TIMEOUT = 1.2
#: Seconds after which SYS_STATUS and a position are outdated.
CHECKS_OLD = 3.0
#: Seconds after a change of mode until the bit refers to the new mode.
SETTLES = 2.0
#: Seconds between two checks, and between two attempts to enter the arming mode.
CHECK_INTERVAL, MODE_RETRY_INTERVAL = 0.5, 3.0
#: Seconds after which a wait is logged: more than a change of mode takes.
LONG = SETTLES + 1.0


class Readiness:
    """Pre-arm checks."""

    def __init__(self, vehicle: Contact, motion: Motion) -> None:
        self._vehicle, self._state, self._motion = vehicle, vehicle.state, motion
        # Reports from before a change of mode are ignored.
        self._valid_from = -math.inf

    async def do_is_ready(self) -> bool:
        """Whether the vehicle can be armed, or is armed."""
        return not self._missing()

    async def do_why_not_ready(self) -> str:
        """The reason why the vehicle cannot be armed, in the autopilot's words if available; '' when it
        can.
        """
        condition = self._missing()
        return await self._reason_text(condition) if condition else ""

    async def do_wait_ready(self, seconds: float) -> None:
        """Waits until the vehicle can be armed, in the arming mode. Raises DeviceError with the reason."""
        vehicle = self._vehicle
        if not 0.0 <= seconds < math.inf:
            raise vehicle.error(f"waitReady requires seconds of at least 0, not {seconds:g}")
        start = vehicle.clock.monotonic()
        mode_sent_at, is_logged = -math.inf, False
        self._valid_from = -math.inf
        while condition := self._missing() or self._mode_mismatch():
            now = vehicle.clock.monotonic()
            if now - start >= seconds:
                raise await self._timeout_error(seconds, condition)
            if now - start >= LONG and not is_logged:
                vehicle.note(log_messages.NOT_ARMABLE.line(reason=condition))
                is_logged = True
            if self._is_in_another_mode and now - mode_sent_at >= MODE_RETRY_INTERVAL:
                await self._enter_mode()
                mode_sent_at = vehicle.clock.monotonic()
                self._valid_from = mode_sent_at + SETTLES
            await vehicle.wait_for(
                lambda: not (self._missing() or self._mode_mismatch()),
                min(CHECK_INTERVAL, start + seconds - now),
            )

    async def _reason_text(self, condition: str) -> str:
        """The autopilot's texts against arming, on request; else the missing condition."""
        vehicle, now = self._vehicle, self._vehicle.clock.monotonic()
        # PX4 sends no texts without station heartbeats, and then nothing is requested.
        if not vehicle.is_quiet and vehicle.silence <= LINK_LOST:
            await vehicle.exchange.command(dialect.MAV_CMD_RUN_PREARM_CHECKS)
            # Several arrive at once: wait for the others too.
            await vehicle.wait_for(lambda: bool(self._complaints(now)), TEXT_TIMEOUT)
            await vehicle.wait_for(lambda: False, 0.2 * TEXT_TIMEOUT)
        earlier = self._complaints(now - TEXT_MAX_AGE) if condition.startswith(FAILED) else ""
        conditions = "; ".join(filter(None, dict.fromkeys((condition, self._mode_mismatch()))))
        return self._complaints(now) or earlier or conditions

    def _complaints(self, since: float) -> str:
        texts = (text for text in self._vehicle.texts.since(since) if text.startswith(COMPLAINTS))
        return "; ".join(dict.fromkeys(texts))

    def _missing(self) -> str:
        """The missing condition, '' for none."""
        if crashed := self._motion.monitor.crashed:
            return f"it crashed and must be inspected: {crashed}"
        if self._vehicle.silence > LINK_LOST:
            return f"no message for {self._vehicle.silence:.1f} s"
        if self._vehicle.conflict and not self._state.armed:
            return self._vehicle.conflict
        since = max(self._valid_from, self._vehicle.clock.monotonic() - CHECKS_OLD)
        return missing_condition(self._state, since, px4=self._vehicle.profile.px4)

    def _mode_mismatch(self) -> str:
        """The reason why ArduPilot's checks do not apply to the arming mode, '' when they do.

        A rover's checks pass in MANUAL 20 s before it can be armed in GUIDED.
        """
        profile, mode = self._vehicle.profile, self._state.mode
        if profile.px4 or not self._is_in_another_mode:
            return ""
        return f"its pre-arm checks are for {mode}, but it is armed in {profile.arming}"

    @property
    def _is_in_another_mode(self) -> bool:
        """Whether the vehicle is not in the arming mode; False while a pilot has its motors on."""
        return not self._state.armed and self._state.mode != self._vehicle.profile.arming

    async def _enter_mode(self) -> None:
        """Enters the arming mode, again after a refusal: an autopilot that starts up may revert it."""
        with suppress(DeviceError):
            await self._motion.set_mode(self._vehicle.profile.arming)

    async def _timeout_error(self, seconds: float, condition: str) -> DeviceError:
        reason = await self._reason_text(condition)
        return self._vehicle.error(f"waitReady: it cannot be armed after {seconds:g} s: {reason}")


def missing_condition(state: VehicleState, since: float, *, px4: bool) -> str:
    """The condition that a vehicle lacks for arming, as reported since `since`; '' for none. Pure."""
    if state.armed:
        return ""
    sensors = state.sensors
    if sensors is None or sensors.at < since:
        return "waiting for the autopilot's pre-arm checks"
    if state.critical:
        return "its failsafe is active"
    # PX4 sets only the health bit; ArduPilot neither when checks are disabled.
    is_checked = px4 or bool(sensors.present & sensors.enabled & PREARM)
    if is_checked and not sensors.healthy & PREARM:
        unhealthy = ", ".join(sensors.unhealthy)
        return FAILED + (f"; unhealthy: {unhealthy}" if unhealthy else "")
    if state.placed_at < since:
        return "its position is unknown"
    return ""
