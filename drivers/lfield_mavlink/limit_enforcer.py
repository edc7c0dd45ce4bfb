"""Enforces the limits of the binding by telemetry: logs an excess, corrects it, finally makes the vehicle
safe.

An autopilot may forget commanded limits, and uses its own speed and height in automatic modes. A speed is
corrected by a lower commanded speed, and once per motion the original speed is tried again; a position by a
hold. A vehicle under foreign control is only logged, as is one that descends or returns beyond a height or
radius, since no other action would be safer.
"""

from __future__ import annotations

import asyncio
import math

from msgspec import Struct

from lfield.driver import DeviceError
from lfield_mavlink import log_messages
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.limits import LimitWatch, Verdict
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.parts.motion_control import Motion

#: m/s outward that do not count: a hover in gusts.
STILL = 0.5
#: The least share of its limit that a speed is corrected to.
LEAST = 0.5

_FORMATS = {
    "speed": "{:.1f} m/s over ground",
    "altitude": "{:.1f} m above home",
    "radius": "{:.1f} m from home",
}
_UNITS = {"speed": "m/s", "altitude": "m", "radius": "m"}


class _LimitState(Struct):
    """One limit: its watch, the last value, and the corrections since it was exceeded."""

    limit: float
    watch: LimitWatch
    value: float = 0.0
    is_logged: bool = False
    corrected: bool = False
    #: The time since which the value is within its limit after a correction.
    within_since: float | None = None


class LimitEnforcer:
    """Watches one vehicle by its LOCAL_POSITION_NED, and corrects it in `run`."""

    def __init__(self, vehicle: Contact, motion: Motion) -> None:
        self._vehicle, self._state, self._motion = vehicle, vehicle.state, motion
        share = 1.0 + vehicle.binding.option("limit_tolerance")
        time: float = vehicle.binding.option("limit_time")
        self._limits = {
            name: _LimitState(limit, LimitWatch(limit * share, time, 0.0 if name == "speed" else STILL))
            for name, limit in vehicle.binding.limits.items()
        }
        # Limits to correct, or (False) that have been within the limit for a while.
        self._tasks: asyncio.Queue[tuple[str, bool]] = asyncio.Queue()
        vehicle.on(dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, self._on_position)

    async def run(self) -> None:
        """Corrects excesses until cancelled."""
        while True:
            name, is_exceeded = await self._tasks.get()
            state = self._limits[name]
            try:
                if is_exceeded:
                    await self._correct(name, state)
                elif not state.corrected:
                    await self._speed_up()
            except DeviceError as error:
                self._vehicle.note(log_messages.LIMIT_NOT_CORRECTED.line(quantity=name, reason=error.reason))
            state.watch.on_correction_sent(self._vehicle.clock.monotonic())

    # -- watching ---------------------------------------------------------------------------------------

    def _on_position(self, _: object) -> None:
        now = self._vehicle.clock.monotonic()
        for name, state in self._limits.items():
            is_watched = self._state.armed and not self._vehicle.is_quiet
            sample = self._sample(name, state) if is_watched else None
            if sample is None:
                state.watch.reset()
                state.is_logged = state.corrected = False
                state.within_since = None
                continue
            state.value, excess = sample
            verdict = state.watch.sample(state.value, excess, now)
            if verdict is Verdict.WITHIN:
                state.is_logged = state.corrected = False
                state.within_since = now if name == "speed" else None
                self._vehicle.note(log_messages.LIMIT_KEPT.line(limit=self._limit(name)))
            elif verdict is not None:
                state.within_since = None
                self._act(name, state, now)
            elif state.within_since is not None and now - state.within_since >= state.watch.time:
                state.within_since = None
                self._tasks.put_nowait((name, False))

    def _sample(self, name: str, state: _LimitState) -> tuple[float, float] | None:
        """A value and its excess, for `LimitWatch`; None if it does not apply."""
        position, (north, east, down) = self._state.position, self._state.velocity
        if name != "altitude" and self._motion.monitor.is_blind:
            return None  # the estimator drifts at rest
        if name == "speed":
            speed = math.hypot(north, east)
            return speed, speed - state.watch.bound
        if position is None or not self._state.knows_frames:
            return None
        if name == "altitude":
            return (-position[2], -down) if self._vehicle.profile.flies else None
        distance = math.hypot(*position[:2])
        return distance, (position[0] * north + position[1] * east) / distance if distance else 0.0

    def _act(self, name: str, state: _LimitState, now: float) -> None:
        """Handles a limit that is exceeded, or still is after a correction."""
        if reason := self._exempt_reason(name):
            state.watch.on_correction_sent(now)
            if not state.is_logged:
                excess = self._describe(name, state)
                self._vehicle.note(log_messages.LIMIT_EXEMPT.line(excess=excess, reason=reason))
        elif not state.corrected:
            state.corrected = True
            suffix = " for the rest of this motion" if self._motion.speed.was_slowed else ""
            correction = f"commanded to be slower{suffix}" if name == "speed" else "holding"
            excess = self._describe(name, state)
            self._vehicle.note(log_messages.LIMIT_EXCEEDED.line(excess=excess, correction=correction))
            self._tasks.put_nowait((name, True))
        else:
            self._vehicle.breach(f"{self._describe(name, state)}, and corrections had no effect")
        state.is_logged = True

    def _exempt_reason(self, name: str) -> str:
        """The reason why an excess is not corrected; '' when it is."""
        mode = self._state.mode
        if not self._motion.is_ours:
            return f"since a pilot or a failsafe controls it in {mode}"
        is_retreating = mode in self._vehicle.profile.fallbacks and mode != self._vehicle.profile.hold
        if name != "speed" and is_retreating:
            return f"since it is in {mode}, which is safer"
        return ""

    # -- correcting -------------------------------------------------------------------------------------

    async def _correct(self, name: str, state: _LimitState) -> None:
        """Corrects by the autopilot's own means. Raises DeviceError."""
        reason = self._describe(name, state)
        if name == "speed":
            # Lower by as much as the vehicle is too fast: some autopilots exceed a commanded speed by half.
            await self._motion.slow_down(state.limit * max(state.limit / state.value, LEAST), reason)
        else:
            await self._motion.halt(reason)

    async def _speed_up(self) -> None:
        """Restores the original speed if the corrected motion is still running."""
        speed = self._motion.speed.speed_to_restore
        if speed is not None and self._state.armed and self._motion.is_ours:
            self._vehicle.note(log_messages.SPEED_RESTORED.line(speed=speed))
            await self._motion.speed.speed_up(speed)

    def _describe(self, name: str, state: _LimitState) -> str:
        return f"{_FORMATS[name].format(state.value)}, beyond its limit of {self._limit(name)}"

    def _limit(self, name: str) -> str:
        return f"{self._limits[name].limit:g} {_UNITS[name]}"
