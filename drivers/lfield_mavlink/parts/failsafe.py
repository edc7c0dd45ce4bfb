"""Whether the autopilot's own failsafe has the vehicle, also in a mode that the program itself uses.

By the recordings (`e-gcs-loss`, `f-fence-breach`, `f-fence-landing`): PX4 says "Failsafe activated", and its
CURRENT_MODE has another intended mode than the one it is in; where both are the same (a hold in place of a
hold) its heartbeat says CRITICAL. ArduPilot says "GCS Failsafe" and is CRITICAL; of a fence it tells
FENCE_STATUS, and is in its new mode within 0.1 s. What it says it does not always do: so only the mode in
which it is then, or is led to at once, is its failsafe's.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

from lfield_mavlink.contact.contact import EXPLAINS, Contact
from lfield_mavlink.link.dialect import dialect

#: Seconds in which the mode of a failsafe shows after the word of it; a packet of it may be lost.
LED = 0.8
#: Seconds after a release in which words are still those of the failsafe that it was released from: PX4's
#: heartbeat comes once a second.
LATE = 1.5
#: Seconds before a failsafe is noticed in which its reason may have been said.
BEFORE = 0.5

#: That a failsafe acts, and what is said of one that does not, or not any more.
_ACTS = re.compile(r"failsafe|fence breached", re.IGNORECASE)
_DOES_NOT = re.compile(r"cleared|warning|^(preflight|prearm|arm):?", re.IGNORECASE)
#: What ArduPilot says when it leaves its fence.
_BREACH = re.compile(r"fence breached", re.IGNORECASE)
#: What names the reason of a failsafe.
_NAMES = re.compile(r"failsafe|geofence: |fence breached|battery", re.IGNORECASE)


class Failsafe:
    """The failsafe of one vehicle; `on_taken` is called when it takes it."""

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle, self._state = vehicle, vehicle.state
        self.on_taken: Callable[[], None] = lambda: None
        #: Whether it has the vehicle, until that is released or led elsewhere.
        self.has_it = False
        # When it was noticed, when it was released last, and what was known of it.
        self._noticed_at = self._released_at = -math.inf
        self._was_critical, self._overruled, self._breaches = False, "", 0
        # Whether CURRENT_MODE has told who chose the mode, and so tells the next one.
        self._led = False
        vehicle.on(dialect.MAVLINK_MSG_ID_HEARTBEAT, self._on_heartbeat)
        vehicle.on(dialect.MAVLINK_MSG_ID_CURRENT_MODE, self._on_current_mode)
        vehicle.on(dialect.MAVLINK_MSG_ID_STATUSTEXT, self._on_text)
        vehicle.on(dialect.MAVLINK_MSG_ID_FENCE_STATUS, self._on_fence)

    @property
    def words(self) -> str:
        """What the autopilot has said of it, with commas between; '' when it has said nothing."""
        said = self._vehicle.texts.since(self._noticed_at - BEFORE)
        named = (text for text in said if _NAMES.search(text) and not _DOES_NOT.search(text))
        return ", ".join(dict.fromkeys(named))

    @property
    def holder(self) -> str:
        """Who has a vehicle that is not ours, as far as that is known."""
        # PX4 tells when somebody has chosen a mode after it.
        return "its failsafe" if self.has_it and not self._led else self._state.holder

    @property
    def holding(self) -> str:
        """That somebody else has it: `its failsafe has it (Circle fence breached)`."""
        return f"{self.holder} has it" + (f" ({self.words})" if self.has_it and self.words else "")

    async def explains(self) -> None:
        """Wait a moment for what is said of a motion that ended: the words may come after the mode."""
        now = self._vehicle.clock.monotonic()
        await self._vehicle.seen(lambda: bool(self.words or self._vehicle.texts.since(now)), EXPLAINS)

    def release(self) -> None:
        """The program takes the vehicle back."""
        self.has_it, self._led, self._noticed_at = False, False, -math.inf
        self._state.has_failsafe = False
        self._released_at = self._vehicle.clock.monotonic()

    async def did_the_same(self, what: str, command: int, *values: float) -> None:
        """It may have done what this command is for, when PX4 missed its setpoints before that came.

        It names no reason then, and its text may come later than the mode. If it has acted, have the command
        taken: the mode is this program's. Raises DeviceError.
        """
        if not self.has_it:
            self._released_at = self._vehicle.clock.monotonic()
        elif set(self.words.split(", ")) <= {"", "Failsafe activated"}:
            await self._vehicle.command(what, command, *values)
            self.release()

    def has_had_it(self) -> None:
        """It, or somebody else, had the vehicle before all that is known here."""
        self._notice()

    # -- what tells it ----------------------------------------------------------------------------------

    def _on_heartbeat(self, _: Any) -> None:
        begins = self._state.critical and not self._was_critical
        self._was_critical = self._state.critical
        if begins and not self._notice_late() and self._vehicle.exchange.px4:
            # PX4 ends it when it takes a command: one that lasts is another one.
            self._was_critical = False
        self._look()

    def _on_current_mode(self, _: Any) -> None:
        overruled = self._state.overruled or ""
        # A mode, never a late word: it counts also right after a release.
        if overruled and overruled != self._overruled:
            self._notice()
            self._led = True
        self._overruled = overruled
        self._look()

    def _on_text(self, _: Any) -> None:
        now = self._vehicle.clock.monotonic()
        acts = [t for t in self._vehicle.texts.since(now) if _ACTS.search(t) and not _DOES_NOT.search(t)]
        if any(_BREACH.search(text) for text in acts):
            # FENCE_STATUS comes once a second: where the breach is caught, it must not read as none.
            self._vehicle.publish(fenceBreached=True)
        if acts:
            self._notice_late()

    def _on_fence(self, message: Any) -> None:
        breaches = message.breach_count if message.breach_status else 0
        if breaches and breaches != self._breaches:
            self._notice_late()
        self._breaches = breaches

    def _notice_late(self) -> bool:
        """Notice what may come late, unless it is of a failsafe that was released; whether it was noticed."""
        if self._vehicle.clock.monotonic() - self._released_at <= LATE:
            return False
        self._notice()
        return True

    def _notice(self) -> None:
        if self._state.armed:
            self._noticed_at = self._vehicle.clock.monotonic()
            self._look()

    def _look(self) -> None:
        """Whether the mode is one that it has chosen."""
        state = self._state
        retreats = state.profile is not None and state.armed and state.mode in state.profile.fallbacks
        recent = self._vehicle.clock.monotonic() - self._noticed_at <= LED
        if not retreats:
            self.has_it = self._led = self._state.has_failsafe = False
        elif recent and not self.has_it:
            self.has_it = self._state.has_failsafe = True
            self._vehicle.publish(mode=state.mode, failsafe=True)
            self.on_taken()
