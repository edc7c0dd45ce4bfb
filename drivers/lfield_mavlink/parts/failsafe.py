"""Detects the autopilot's own failsafe, even in a mode that the program itself uses.

From recordings (`e-gcs-loss`, `f-fence-breach`, `f-fence-landing`): PX4 sends "Failsafe activated", and its
CURRENT_MODE has an intended mode that differs from the actual one; if both are equal (a hold that replaces a
hold) its heartbeat is CRITICAL. ArduPilot sends "GCS Failsafe" and is CRITICAL; for a fence it sends
FENCE_STATUS and changes its mode within 0.1 s. Texts are not always followed by an action: only the mode at
that time, or the one entered at once, is the failsafe's.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

from lfield_mavlink.contact.contact import REASON_TIMEOUT, Contact
from lfield_mavlink.link.dialect import dialect

#: Seconds in which the mode of a failsafe appears after its text; one packet may be lost.
MODE_DELAY = 0.8
#: Seconds after a release in which texts still belong to the released failsafe: PX4's heartbeat comes once a
#: second.
LATE = 1.5
#: Seconds before the detection of a failsafe in which its reason may have been sent.
BEFORE = 0.5

#: Texts of an active failsafe, and of one that has ended or not started.
_ACTS = re.compile(r"failsafe|fence breached", re.IGNORECASE)
_DOES_NOT = re.compile(r"cleared|warning|^(preflight|prearm|arm):?", re.IGNORECASE)
#: Text of ArduPilot when it leaves its fence.
_BREACH = re.compile(r"fence breached", re.IGNORECASE)
#: Texts that contain the reason of a failsafe.
_NAMES = re.compile(r"failsafe|geofence: |fence breached|battery", re.IGNORECASE)


class Failsafe:
    """The failsafe of one vehicle; `on_engaged` is called when it takes control."""

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle, self._state = vehicle, vehicle.state
        self.on_engaged: Callable[[], None] = lambda: None
        #: Whether the failsafe has control, until it is released or another mode is commanded.
        self.is_engaged = False
        # The times when the failsafe was detected and last released, and its state.
        self._detected_at = self._released_at = -math.inf
        self._was_critical, self._overruled, self._breaches = False, "", 0
        # Whether CURRENT_MODE has reported the controller of the mode; then it reports the next one too.
        self._is_mode_reported = False
        vehicle.on(dialect.MAVLINK_MSG_ID_HEARTBEAT, self._on_heartbeat)
        vehicle.on(dialect.MAVLINK_MSG_ID_CURRENT_MODE, self._on_current_mode)
        vehicle.on(dialect.MAVLINK_MSG_ID_STATUSTEXT, self._on_text)
        vehicle.on(dialect.MAVLINK_MSG_ID_FENCE_STATUS, self._on_fence)

    @property
    def text(self) -> str:
        """The autopilot's texts about the failsafe, separated by commas; '' without any."""
        texts = self._vehicle.texts.since(self._detected_at - BEFORE)
        reasons = (text for text in texts if _NAMES.search(text) and not _DOES_NOT.search(text))
        return ", ".join(dict.fromkeys(reasons))

    @property
    def holder(self) -> str:
        """The controller of a vehicle that is not ours, as far as known."""
        # PX4 reports when a station or pilot has selected a mode after it.
        return "its failsafe" if self.is_engaged and not self._is_mode_reported else self._state.holder

    @property
    def holding(self) -> str:
        """Describes foreign control: `its failsafe controls the vehicle (Circle fence breached)`."""
        return f"{self.holder} controls the vehicle" + (
            f" ({self.text})" if self.is_engaged and self.text else ""
        )

    async def await_text(self) -> None:
        """Waits briefly for a text about a motion that ended: it may arrive after the mode."""
        now = self._vehicle.clock.monotonic()
        await self._vehicle.wait_for(
            lambda: bool(self.text or self._vehicle.texts.since(now)), REASON_TIMEOUT
        )

    def set_engaged_handler(self, on_engaged: Callable[[], None]) -> None:
        """Sets the function that is called when the failsafe takes control."""
        self.on_engaged = on_engaged

    def release(self) -> None:
        """Ends the control by the failsafe: the program takes control again."""
        self.is_engaged, self._is_mode_reported, self._detected_at = False, False, -math.inf
        self._state.set_failsafe(False)
        self._released_at = self._vehicle.clock.monotonic()

    async def check_after_command(self, action: str, command: int, *values: float) -> None:
        """Checks whether the failsafe acted before this command because PX4 missed its setpoints.

        PX4 reports no reason then, and its text may arrive after the mode. If it has acted, the accepted
        command makes the mode this program's. Raises DeviceError.
        """
        if not self.is_engaged:
            self._released_at = self._vehicle.clock.monotonic()
        elif set(self.text.split(", ")) <= {"", "Failsafe activated"}:
            await self._vehicle.command(action, command, *values)
            self.release()

    def on_earlier_engagement(self) -> None:
        """Records that a failsafe or another controller had the vehicle before contact was made."""
        self._detect()

    # -- detection --------------------------------------------------------------------------------------

    def _on_heartbeat(self, _: Any) -> None:
        is_new = self._state.critical and not self._was_critical
        self._was_critical = self._state.critical
        if is_new and not self._detect_late() and self._vehicle.exchange.px4:
            # PX4 ends it when it accepts a command: a persisting one is new.
            self._was_critical = False
        self._check_mode()

    def _on_current_mode(self, _: Any) -> None:
        overruled = self._state.overruled or ""
        # A mode, never a late text: valid even right after a release.
        if overruled and overruled != self._overruled:
            self._detect()
            self._is_mode_reported = True
        self._overruled = overruled
        self._check_mode()

    def _on_text(self, _: Any) -> None:
        now = self._vehicle.clock.monotonic()
        acts = [t for t in self._vehicle.texts.since(now) if _ACTS.search(t) and not _DOES_NOT.search(t)]
        if any(_BREACH.search(text) for text in acts):
            # FENCE_STATUS comes once a second: a program that catches the breach must not read false.
            self._vehicle.publish(fenceBreached=True)
        if acts:
            self._detect_late()

    def _on_fence(self, message: Any) -> None:
        breaches = message.breach_count if message.breach_status else 0
        if breaches and breaches != self._breaches:
            self._detect_late()
        self._breaches = breaches

    def _detect_late(self) -> bool:
        """Detects a failsafe by late messages, except those of a released one; returns whether it did."""
        if self._vehicle.clock.monotonic() - self._released_at <= LATE:
            return False
        self._detect()
        return True

    def _detect(self) -> None:
        if self._state.armed:
            self._detected_at = self._vehicle.clock.monotonic()
            self._check_mode()

    def _check_mode(self) -> None:
        """Checks whether the failsafe selected the mode."""
        state = self._state
        is_in_fallback = state.profile is not None and state.armed and state.mode in state.profile.fallbacks
        is_recent = self._vehicle.clock.monotonic() - self._detected_at <= MODE_DELAY
        if not is_in_fallback:
            self.is_engaged = self._is_mode_reported = False
            self._state.set_failsafe(False)
        elif is_recent and not self.is_engaged:
            self.is_engaged = True
            self._state.set_failsafe(True)
            self._vehicle.publish(mode=state.mode, failsafe=True)
            self.on_engaged()
