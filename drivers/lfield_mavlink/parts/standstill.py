"""Whether a vehicle is at rest in its safe state, or the motion that remains.

With its motors off a vehicle is at rest; if that is unknown, it is not. A copter that lands or returns is at
rest when its motors are off, in `hold` when it hovers; a rover or boat when it is stationary, in `return` at
home; a submarine at the surface, or in `hold` where it is. A fixed wing is at rest when it circles its
position: in `hold` anywhere, under ArduPilot's RTL at home.

A vehicle under a pilot's control is at rest when its motors are off. One under a failsafe's control is
monitored until it is on the ground.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from lfield_mavlink.contact.contact import LINK_LOST, Contact
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.parts.motion_control import Motion

#: m/s below which a vehicle is stationary or hovers: a gust, or PX4's noise on the ground.
STILL = 0.5
#: The same for a boat with its motors off: wind and current move it.
DRIFTS = 1.0
#: Vertical m/s that are reported.
LEVEL = 0.1
#: Metres from home of a rover at home, and of a circling fixed wing (WP_LOITER_RAD is 60).
AT_HOME, CIRCLES = 5.0, 150.0
#: Metres below the surface at which a submarine has surfaced.
SURFACED = 0.5
#: Seconds after which a speed is outdated, as in telemetry.
SPEED_OLD = 3.0
#: Seconds without a heartbeat after which the arming state is unknown.
HEARTBEAT_MAX_AGE = 6.0


class StandstillCheck:
    """Describes the motion of one vehicle from its last messages."""

    def __init__(self, vehicle: Contact, motion: Motion) -> None:
        self._vehicle, self._state, self._motion = vehicle, vehicle.state, motion

    def description(self) -> str:
        """As `Device.moving`: `4.2 m up, sinking at 0.7 m/s`; '' when it is at rest."""
        vehicle, state = self._vehicle, self._state
        if state.heartbeat_at is None:
            return "no message yet"
        armed_age = vehicle.clock.monotonic() - state.armed_at
        if vehicle.silence > LINK_LOST or armed_age > HEARTBEAT_MAX_AGE:
            last_state = ", ".join(self._description_parts()) if state.armed else "with its motors off"
            if vehicle.silence > LINK_LOST:
                return f"no message for {vehicle.silence:.1f} s, last seen {last_state}"
            return f"no heartbeat for {armed_age:.1f} s, motor state unknown; last reported {last_state}"
        if not state.armed or (self._is_at_rest() and not self._is_piloted):
            return ""
        return ", ".join(self._description_parts())

    @property
    def _is_piloted(self) -> bool:
        """Whether the vehicle is in a mode that neither this program nor a failsafe selects."""
        return not self._motion.is_ours and self._state.mode not in self._vehicle.profile.fallbacks

    # -- at rest, with its motors on --------------------------------------------------------------------

    def _is_at_rest(self) -> bool:
        """Whether the vehicle does only what its safe state requires."""
        mode, profile = self._state.mode, self._vehicle.profile
        if mode not in profile.fallbacks:
            # The vehicle was moved out of its safe state, and may move again.
            return False
        return _REST_CHECKS[profile.kind](self, mode)

    def _is_copter_at_rest(self, mode: str) -> bool:
        return not self._state.landed and self._holds(mode) and self._slower_than(STILL)

    def _is_plane_at_rest(self, mode: str) -> bool:
        profile = self._vehicle.profile
        if self._state.landed:
            return False
        is_fixed_wing = self._state.type == dialect.MAV_TYPE_FIXED_WING
        circles_home = is_fixed_wing and mode == profile.home and not profile.px4
        return self._holds(mode) or (circles_home and self._within(CIRCLES))

    def _is_rover_at_rest(self, mode: str) -> bool:
        is_boat = self._state.type == dialect.MAV_TYPE_SURFACE_BOAT
        has_arrived = mode != self._vehicle.profile.home or self._within(AT_HOME)
        return has_arrived and self._slower_than(DRIFTS if is_boat else STILL)

    def _is_submarine_at_rest(self, mode: str) -> bool:
        height, surfaces = self._state.height, mode == self._vehicle.profile.land
        is_in_place = height is not None and height >= -SURFACED if surfaces else self._holds(mode)
        return is_in_place and self._slower_than(DRIFTS)

    def _holds(self, mode: str) -> bool:
        """Whether the safe state is to hold and the vehicle is in that mode."""
        return self._vehicle.safe_state == "hold" and mode == self._vehicle.profile.hold

    def _slower_than(self, bound: float) -> bool:
        speeds = self._speeds
        return speeds is not None and math.hypot(*speeds) < bound

    def _within(self, metres: float) -> bool:
        """Whether the horizontal distance from home is at most `metres`."""
        position = self._state.position
        return position is not None and math.hypot(*position[:2]) <= metres

    # -- description ------------------------------------------------------------------------------------

    @property
    def _speeds(self) -> tuple[float, float] | None:
        """Horizontal and upward speed, None when outdated."""
        state = self._state
        is_recent = (
            state.speeds is not None and self._vehicle.clock.monotonic() - state.speeds_at <= SPEED_OLD
        )
        return state.speeds if is_recent else None

    def _description_parts(self) -> list[str]:
        """The position and motion of the vehicle; its mode, if that is not the commanded one."""
        state, profile = self._state, self._vehicle.profile
        motions = [self._place_text(), *self._motion_texts()]
        if self._is_piloted:
            return [f"{'flown' if profile.flies else 'steered'} by a pilot in {state.mode}", *motions]
        # PX4 leaves its landing mode when it switches its motors off, and reports the mode first.
        has_ended = self._has_landed and state.mode in (profile.guided, *profile.own)
        if state.mode != profile.safe(self._vehicle.safe_state) and not has_ended:
            motions.append(f"in {state.mode}")
        return motions

    def _place_text(self) -> str:
        state, kind = self._state, self._vehicle.profile.kind
        if kind == "rover":
            return "motors on"
        if kind == "submarine":
            return "motors on" if state.height is None else f"{_above_zero(-state.height):.1f} m deep"
        if state.landed:
            return "on the ground, motors on"
        if state.height is None:
            return "motors on" if state.landed is None else "in the air"
        return f"{_above_zero(state.height):.1f} m up"

    def _motion_texts(self) -> list[str]:
        if self._speeds is None:
            return ["at an unknown speed"]
        ground, climb = self._speeds
        motions = []
        if abs(climb) >= LEVEL and self._vehicle.profile.kind != "rover" and not self._has_landed:
            motions.append(f"{'climbing' if climb > 0.0 else 'sinking'} at {abs(climb):.1f} m/s")
        if ground >= STILL:
            motions.append(f"moving at {ground:.1f} m/s")
        position = self._state.position
        if position is not None and self._state.mode == self._vehicle.profile.home and not self._has_landed:
            distance = math.hypot(*position[:2])
            motions += [f"{distance:.0f} m from home"] if distance > AT_HOME else []
        return motions

    @property
    def _has_landed(self) -> bool:
        """Whether the vehicle flies and has landed."""
        return self._vehicle.profile.flies and bool(self._state.landed)


def _above_zero(metres: float) -> float:
    """A height, at least 0.0: an estimate may be below the ground (PX4's by a metre); never -0.0."""
    return max(metres, 0.0) + 0.0


_REST_CHECKS: dict[str, Callable[[StandstillCheck, str], bool]] = {
    "copter": StandstillCheck._is_copter_at_rest,
    "plane": StandstillCheck._is_plane_at_rest,
    "rover": StandstillCheck._is_rover_at_rest,
    "submarine": StandstillCheck._is_submarine_at_rest,
}
