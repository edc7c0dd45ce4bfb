"""The limits of the binding, in telemetry: beyond one it is said, then corrected, and at last made safe.

What an autopilot is told it may forget, and what it does by itself it does at its own speed and height. A
speed is corrected by telling a lower one, and then, once in a motion, the wanted one again; a place by a
hold. A vehicle in other hands is only spoken of; so
is one that is on its way down or home beyond a height or a radius, for nothing that could be done is safer.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass

from lfield.driver import DeviceError
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.limits import LimitWatch, Verdict
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.parts.motion import Motion

#: m/s outwards that are no way out: what a hover makes of a gust.
STILL = 0.5
#: The least share of its limit that a speed is corrected to.
LEAST = 0.5

_WORDS = {
    "speed": "{:.1f} m/s over ground",
    "altitude": "{:.1f} m above home",
    "radius": "{:.1f} m from home",
}
_UNITS = {"speed": "m/s", "altitude": "m", "radius": "m"}


@dataclass(slots=True)
class _Kept:
    """One limit: its watch, the value told last, and what has been done since it was exceeded."""

    limit: float
    watch: LimitWatch
    value: float = 0.0
    said: bool = False
    corrected: bool = False
    #: Since when it is within its limit again after a correction.
    well_since: float | None = None


class LimitKeeper:
    """Watches one vehicle by its LOCAL_POSITION_NED, and acts in `keep`."""

    def __init__(self, vehicle: Contact, motion: Motion) -> None:
        self._vehicle, self._state, self._motion = vehicle, vehicle.state, motion
        share = 1.0 + vehicle.binding.option("limit_tolerance")
        time: float = vehicle.binding.option("limit_time")
        self._kept = {
            name: _Kept(limit, LimitWatch(limit * share, time, 0.0 if name == "speed" else STILL))
            for name, limit in vehicle.binding.limits.items()
        }
        # What is to be corrected, or (False) has been for a while.
        self._tasks: asyncio.Queue[tuple[str, bool]] = asyncio.Queue()
        vehicle.on(dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, self._on_position)

    async def keep(self) -> None:
        """Correct what is exceeded, until cancelled."""
        while True:
            name, exceeded = await self._tasks.get()
            kept = self._kept[name]
            try:
                if exceeded:
                    await self._correct(name, kept)
                elif not kept.corrected:
                    await self._speed_up()
            except DeviceError as error:
                self._vehicle.note(f"its {name} could not be corrected: {error.reason}")
            kept.watch.told(self._vehicle.clock.monotonic())

    # -- watching ---------------------------------------------------------------------------------------

    def _on_position(self, _: object) -> None:
        now = self._vehicle.clock.monotonic()
        for name, kept in self._kept.items():
            watched = self._state.armed and not self._vehicle.quiet
            sample = self._sample(name, kept) if watched else None
            if sample is None:
                kept.watch.reset()
                kept.said = kept.corrected = False
                kept.well_since = None
                continue
            kept.value, excess = sample
            verdict = kept.watch.sample(kept.value, excess, now)
            if verdict is Verdict.WITHIN:
                kept.said = kept.corrected = False
                kept.well_since = now if name == "speed" else None
                self._vehicle.note(f"within its limit of {self._limit(name)} again")
            elif verdict is not None:
                kept.well_since = None
                self._act(name, kept, now)
            elif kept.well_since is not None and now - kept.well_since >= kept.watch.time:
                kept.well_since = None
                self._tasks.put_nowait((name, False))

    def _sample(self, name: str, kept: _Kept) -> tuple[float, float] | None:
        """A value and its excess, as `LimitWatch` has it; None where there is no such thing."""
        position, (north, east, down) = self._state.position, self._state.velocity
        if name != "altitude" and self._motion.monitor.is_blind:
            return None  # What its estimator tells then is a drift.
        if name == "speed":
            speed = math.hypot(north, east)
            return speed, speed - kept.watch.bound
        if position is None or not self._state.knows_frames:
            return None
        if name == "altitude":
            return (-position[2], -down) if self._vehicle.profile.flies else None
        far = math.hypot(*position[:2])
        return far, (position[0] * north + position[1] * east) / far if far else 0.0

    def _act(self, name: str, kept: _Kept, now: float) -> None:
        """It is beyond a limit, or still is although it was corrected."""
        if why := self._left_alone(name):
            kept.watch.told(now)
            if not kept.said:
                self._vehicle.note(f"{self._words(name, kept)}; {why}")
        elif not kept.corrected:
            kept.corrected = True
            again = " for the rest of this motion" if self._motion.speed.was_slowed else ""
            does = f"told to be slower{again}" if name == "speed" else "it holds"
            self._vehicle.note(f"{self._words(name, kept)}; {does}")
            self._tasks.put_nowait((name, True))
        else:
            self._vehicle.breach(f"{self._words(name, kept)}, and no correction has helped")
        kept.said = True

    def _left_alone(self, name: str) -> str:
        """Why nothing is done about it; '' when something is."""
        mode = self._state.mode
        if not self._motion.ours:
            return f"in {mode}, by a pilot or a failsafe: left to them"
        on_its_way = mode in self._vehicle.profile.fallbacks and mode != self._vehicle.profile.hold
        if name != "speed" and on_its_way:
            return f"in {mode}, which is the safer way"
        return ""

    # -- correcting -------------------------------------------------------------------------------------

    async def _correct(self, name: str, kept: _Kept) -> None:
        """By the autopilot's own means. Raises DeviceError."""
        why = self._words(name, kept)
        if name == "speed":
            # By as much lower as it is too fast: some fly half as fast again as they are told.
            await self._motion.slow_down(kept.limit * max(kept.limit / kept.value, LEAST), why)
        else:
            await self._motion.halt(why)

    async def _speed_up(self) -> None:
        """Have it go on at the speed that was wanted, if it still does what it was corrected in."""
        speed = self._motion.speed.faster
        if speed is not None and self._state.armed and self._motion.ours:
            self._vehicle.note(f"told {speed:g} m/s again")
            await self._motion.speed.speed_up(speed)

    def _words(self, name: str, kept: _Kept) -> str:
        return f"{_WORDS[name].format(kept.value)}, beyond its limit of {self._limit(name)}"

    def _limit(self, name: str) -> str:
        return f"{self._kept[name].limit:g} {_UNITS[name]}"
