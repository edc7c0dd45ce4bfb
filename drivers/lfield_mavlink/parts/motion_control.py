"""Starts, maintains, monitors and ends motions, and tracks the controller of the vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress

from lfield.driver import DeviceError
from lfield_mavlink.contact.contact import STATE_TIMEOUT, Contact
from lfield_mavlink.geodesy import Vector
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import AUTONOMOUS
from lfield_mavlink.monitors.flight_monitor import FlightMonitor
from lfield_mavlink.parts.failsafe import Failsafe
from lfield_mavlink.parts.fences import OwnFence
from lfield_mavlink.parts.progress import Arrival, Progress
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.setpoints.guided_mode import GuidedMode, Hover
from lfield_mavlink.setpoints.motion_orders import (
    AutopilotOrders,
    Order,
    ProgressPatience,
    orders_for,
    reposition,
)
from lfield_mavlink.setpoints.setpoint_stream import SetpointStream
from lfield_mavlink.setpoints.speed_control import SpeedControl
from lfield_mavlink.setpoints.trajectory import Stay, Target, Trajectory, stopping_place

#: For flying to a goal, and for driving.
TRAVEL_PATIENCE, DRIVE_PATIENCE = ProgressPatience(), ProgressPatience(turning=40.0, detour=30.0)
#: m/s above which it moves; for a low commanded speed that share of it; never below the noise.
MOVES, SHARE, NOISE = 0.3, 0.5, 0.05
#: Seconds until a stationary vehicle's fence is checked; seconds without a position until a moving target
#: waits.
FENCE_CHECK_DELAY, PLACED = 2.0, 0.5
#: Seconds out of OFFBOARD after which the trajectory ends: an older packet may arrive late.
LEAVE_TIME = 0.7
#: m/s horizontally at which a stop is followed.
STAYS_AT = 1.0


class Motion:
    """Modes and motions of one vehicle, shared by the parts that move it."""

    def __init__(
        self, vehicle: Contact, parameters: Parameters, others: Callable[[], str] = lambda: ""
    ) -> None:
        self._vehicle, self._state, self._parameters = vehicle, vehicle.state, parameters
        self.fence, self.failsafe = OwnFence(vehicle, parameters), Failsafe(vehicle)
        self.monitor = FlightMonitor(vehicle, parameters, others, lambda: self.is_ours)
        self.stream = SetpointStream(vehicle.clock, self.send, self._measured_motion, self._is_followed)
        self.speed = SpeedControl(vehicle, self.stream, parameters)
        self.guided, self.hover = GuidedMode(vehicle), Hover(vehicle)
        self.tolerance: float = vehicle.binding.option("tolerance")
        # The modes of the last command; any other mode is foreign.
        self._commanded: frozenset[str] = frozenset()
        # Start of the last motion, and the reason why this driver stopped it.
        self._started_at, self._stopped = -math.inf, ""
        # The time when the vehicle left OFFBOARD, None while it is in OFFBOARD or entering it.
        self._offboard_left_at: float | None = None
        self._was_in_guided = False
        vehicle.on(dialect.MAVLINK_MSG_ID_HEARTBEAT, self._on_mode)
        vehicle.on(dialect.MAVLINK_MSG_ID_CURRENT_MODE, self._on_mode)

    @property
    def orders(self) -> AutopilotOrders:
        """The command factory for this autopilot."""
        return orders_for(self._vehicle.profile)

    # -- modes ----------------------------------------------------------------------------------------

    @property
    def is_ours(self) -> bool:
        """Whether this program selected the mode; always true for a vehicle at rest."""
        if self.failsafe.is_engaged or self.monitor.foreign or not self._state.armed:
            return not self._state.armed
        profile = self._vehicle.profile
        # The vehicle changes modes by itself on the ground only; else another controller has done so.
        may_change = self._state.landed if profile.flies else self._commanded != {profile.guided}
        own_modes = profile.own if may_change else ()
        return self._state.mode in (profile.guided, *own_modes, *self._commanded)

    @property
    def foreign_control(self) -> str:
        """Describes the controller that has replaced this program, '' for none."""
        unknown = f"the vehicle is in {self._state.mode}, which this program did not select"
        return "" if self.is_ours else self.monitor.foreign or f"{unknown}; {self.failsafe.holding}"

    def claim(self, *modes: str) -> None:
        """Sets the modes that this program has selected."""
        self._commanded = frozenset(modes)

    def release(self) -> None:
        """Takes control in the present mode, also if another station selected it."""
        self.failsafe.release()
        self.monitor.release()
        self.claim(self._state.mode)

    def start_motion(self, action: str) -> None:
        """Ends the last motion for a new one. Raises DeviceError under foreign control."""
        self._vehicle.check_link()
        self._vehicle.check_identity()
        if reason := self.foreign_control:
            raise self._vehicle.error(f"{action} refused: {reason}. release() takes control again")
        self.monitor.check_start(action)
        self._vehicle.assume_control()
        self._started_at, self._stopped = self._vehicle.clock.monotonic(), ""
        self.speed.on_motion_started()
        self.brake()

    async def halt(self, reason: str) -> None:
        """Holds, and ends the running motion with this reason. Raises DeviceError."""
        self._stopped = reason
        self.brake()
        await self.hold()

    async def hold(self) -> None:
        """Stops and stays: in the hold mode, or a PX4 copter by setpoints. Raises DeviceError.

        In its hold mode PX4 would stay as long as it receives heartbeats of any ground station.
        """
        profile, place = self._vehicle.profile, self._resting_place
        if profile.by_trajectory and profile.flies and place is not None and self._state.landed is False:
            # Without a position only its hold mode remains.
            with suppress(DeviceError):
                await self.start("hold", Order(frozenset({profile.guided}), trajectory=Stay(place, STAYS_AT)))
                return
        await self.set_mode(profile.hold)
        self.hover.start()

    def brake(self) -> None:
        """Ends every motion: a PX4 copter stops by the setpoints that it needs anyway."""
        place, profile = self._resting_place, self._vehicle.profile
        if place and self.stream.is_running and self._is_fed and profile.by_trajectory and profile.flies:
            self._start_stream(Stay(place, STAYS_AT))
        else:
            self.stream.stop()

    @property
    def _resting_place(self) -> Vector | None:
        """The place where the vehicle would stop by braking now, in metres of home; None if unknown."""
        place = self._state.position
        is_known = place is not None and self._state.home is not None and self._state.armed
        is_known = is_known and not (self.monitor.lost_position or self.monitor.foreign)
        return stopping_place(place, self._state.velocity) if is_known and place is not None else None

    async def set_mode(self, name: str) -> None:
        """Enters a mode; the hold mode also stops the vehicle. Raises DeviceError."""
        self.speed.forget_slowing()
        if name != self._vehicle.profile.hold or not await self._send_stay():
            values = self._vehicle.profile.mode_command(name)
            await self.enter(f"mode {name}", name, dialect.MAV_CMD_DO_SET_MODE, *values)

    async def _send_stay(self) -> bool:
        """Sends PX4 a goal where it can stop, if it may be flying to one; returns whether PX4 accepted.

        In its hold mode PX4 flies to a goal of a ground station, also if that mode is commanded again.
        """
        profile, state, place = self._vehicle.profile, self._state, self._resting_place
        if not profile.px4 or state.mode != profile.hold or place is None:
            return False
        was_fed = self._is_fed
        try:
            await self._start_order("hold", reposition(state, place, None))
        except DeviceError:
            return False
        if was_fed:
            values = profile.mode_command(profile.hold)
            await self.failsafe.check_after_command("hold", dialect.MAV_CMD_DO_SET_MODE, *values)
        self.stream.stop()
        return True

    async def enter(
        self,
        action: str,
        mode: str,
        command: int,
        *values: float,
        is_done: Callable[[], bool] = lambda: False,
    ) -> None:
        """Enters a mode by a command, unless `is_done` returns True. Raises DeviceError."""
        self.hover.end()
        self.monitor.on_mode(mode)
        # Set before success is known: a repeated safe state is ours, and so is a mode that is not left.
        self._commanded |= {mode}
        was_fed = self._is_fed
        await self._vehicle.achieve(
            action, lambda: self._state.mode == mode or is_done(), command, *values, mode=mode
        )
        if was_fed:
            await self.failsafe.check_after_command(action, command, *values)
        if mode != self._vehicle.profile.guided:
            self.stream.stop()
        self.claim(mode)

    # -- motions --------------------------------------------------------------------------------------

    async def start(self, action: str, order: Order, is_accepted: Callable[[], bool] | None = None) -> None:
        """Starts an order. Raises DeviceError, also for an autonomous PX4 motion without a waiver."""
        if order.command is not None and self._vehicle.profile.px4:
            self._check_waived(action, f"PX4 flies {' or '.join(sorted(order.modes))} by itself")
        await self._start_order(action, order, is_accepted)

    async def _start_order(
        self, action: str, order: Order, is_accepted: Callable[[], bool] | None = None
    ) -> None:
        if order.mode and self._state.mode != order.mode:
            await self.set_mode(order.mode)
        self.monitor.on_order(order)
        # As in `enter`: the present mode is ours until the new one is reported.
        self._commanded |= order.modes
        if (command := order.command) is not None:
            self.speed.on_command_started()
            await self._vehicle.command(
                action, command.number, *command.values, place=command.place, is_accepted=is_accepted
            )
        if order.trajectory is not None:
            await self._follow(action, order.trajectory)
        await self._vehicle.until(lambda: self._state.mode in order.modes, STATE_TIMEOUT, action)
        self.claim(*order.modes)
        await self.speed.fly_at(order.speed if order.command is None else None, self.send)

    def check_bounded(self, action: str, mode: str) -> None:
        """Refuses a mode that needs a waiver, since no failsafe ends it when this computer fails.

        The binding's safe state and a landing need none. Raises DeviceError.
        """
        profile, binding = self._vehicle.profile, self._vehicle.binding
        bounded = {profile.land, profile.safe(binding.safe_state)}
        if not profile.flies or self._state.landed is not False:
            bounded.add(profile.hold)
        if mode in profile.autonomous - bounded:
            self._check_waived(action, f"PX4 flies {mode} by itself")
        if mode in profile.piloted - bounded and self._state.landed is False:
            self._check_waived(action, f"the failsafe of ArduCopter leaves {mode} to a pilot")

    def _check_waived(self, action: str, reason: str) -> None:
        if not self._vehicle.binding.waives(AUTONOMOUS):
            raise self._vehicle.error(
                f"{action} refused: {reason}, and would continue if this computer fails, even beside another "
                f"ground station. Use goTo, orbit, hold and land, or accept it by 'waivers: {{{AUTONOMOUS}: "
                f"REASON}}' in its binding"
            )

    async def _follow(self, action: str, trajectory: Trajectory) -> None:
        """Starts a trajectory in OFFBOARD and confirms it. Raises DeviceError."""
        self._start_stream(trajectory)
        try:
            until = self._vehicle.clock.monotonic() + STATE_TIMEOUT
            await self.guided.enter_offboard(action, until, f"{STATE_TIMEOUT:g} s")
        except BaseException:
            self.stream.stop()
            raise

    def _start_stream(self, trajectory: Trajectory) -> None:
        self._offboard_left_at, self._was_in_guided = None, self._is_fed
        self.stream.follow(trajectory)

    def _measured_motion(self) -> tuple[Vector | None, Vector]:
        """The vehicle's position (None if lost) and velocity."""
        state, now = self._state, self._vehicle.clock.monotonic()
        return state.position if now - state.placed_at <= PLACED else None, state.velocity

    def _is_followed(self) -> bool:
        """Whether the trajectory still applies: not under foreign control, nor with motors off."""
        left_at, now = self._offboard_left_at, self._vehicle.clock.monotonic()
        is_offboard = left_at is None or now - left_at < LEAVE_TIME
        return self._state.armed and is_offboard and not self.monitor.foreign

    @property
    def _is_fed(self) -> bool:
        """Whether PX4 expects setpoints, including before its accepted mode is shown."""
        return self._vehicle.profile.px4 and (self.guided.is_entered or self.guided.is_assumed)

    def _on_mode(self, _: object) -> None:
        """Records when the vehicle leaves OFFBOARD."""
        if self._state.profile is None or self.stream.trajectory is None:
            return
        if self.guided.is_entered:
            self._offboard_left_at, self._was_in_guided = None, True
        elif self._was_in_guided and self._offboard_left_at is None:
            self._offboard_left_at = self._vehicle.clock.monotonic()

    async def travel(
        self,
        action: str,
        order: Order,
        distance: Callable[[Vector], float],
        tolerance: float,
        patience: ProgressPatience = TRAVEL_PATIENCE,
    ) -> None:
        """Waits until `distance` is at most `tolerance`, while it decreases. Raises DeviceError."""
        try:
            await self._travel(action, order, distance, tolerance, patience)
        except BaseException:
            # Failed or cancelled.
            if order.trajectory is not None and self.stream.trajectory is order.trajectory:
                self.brake()
            raise

    async def _travel(
        self,
        action: str,
        order: Order,
        distance: Callable[[Vector], float],
        tolerance: float,
        patience: ProgressPatience,
    ) -> None:
        vehicle, start = self._vehicle, self._vehicle.clock.monotonic()
        progress, sent_at, is_checked = Progress(patience, start, self._state.position), -math.inf, False
        while True:
            now = vehicle.clock.monotonic()
            vehicle.check_link()
            place = self._state.position
            remaining = distance(place) if place is not None else math.inf
            if remaining <= tolerance:
                return
            await self.monitor.check(action, order, remaining)
            await self.check_underway(action, order, start)
            if progress.is_over(remaining, self.is_moving, now, self.speed.motion_speed, place):
                await self._cancel_order(order)
                seconds = patience.bound(self.is_moving, self.speed.motion_speed)
                text = patience.message.format(seconds=seconds, left=remaining, clearance=patience.clearance)
                fence = await self.fence.zones_hint() if order.goal is not None else ""
                raise vehicle.error(f"{action} failed: {text}{fence}")
            if not is_checked and self._is_refused(order, progress, now):
                is_checked = True
                await self._check_fence(action, order)
            if order.target is not None and place is not None and now - sent_at >= order.period:
                self.send(order.target(place))
                sent_at = now
            await vehicle.wait_message(min(0.25, order.period))

    @property
    def patience(self) -> ProgressPatience:
        """The patience for motions to a position."""
        return TRAVEL_PATIENCE if self._vehicle.profile.flies else DRIVE_PATIENCE

    @property
    def is_moving(self) -> bool:
        """Whether the vehicle moves horizontally or vertically, as far as known."""
        speed = self.speed.motion_speed
        minimum = MOVES if speed is None else max(min(MOVES, SHARE * speed), NOISE)
        return self._state.speeds is not None and math.hypot(*self._state.speeds) > minimum

    def _is_refused(self, order: Order, progress: Progress, now: float) -> bool:
        """Whether the autopilot seems to refuse the goal."""
        is_fenced = "geofence" in self._vehicle.reasons(self._started_at)
        return order.goal is not None and (is_fenced or progress.rest_time(now) > FENCE_CHECK_DELAY)

    async def _check_fence(self, action: str, order: Order) -> None:
        """Raises DeviceError when the autopilot's own fence is the reason."""
        assert order.goal is not None, "the caller has checked it"
        texts = self._vehicle.reasons(self._started_at)
        reason = await self.fence.excess_reason(order.goal)
        if reason or "geofence" in texts:
            await self._cancel_order(order)
            reason = reason or "the goal is outside its own fence"
            raise self._vehicle.error(f"{action} refused: {reason}{texts}")

    async def arrival(self) -> Arrival:
        """The rule for the arrival of a rover: ArduPilot stops it within WP_RADIUS of a goal."""
        profile, radius = self._vehicle.profile, 0.0
        if profile.kind == "rover" and not profile.px4:
            radius = await self._parameters.read("WP_RADIUS") or 0.0
        return Arrival(radius, lambda: self.is_moving, self._vehicle.clock.monotonic)

    def send(self, target: Target) -> None:
        """Sends a setpoint in the autopilot's local frame."""
        self.speed.on_sent(target)
        self.monitor.on_sent(target)
        self._vehicle.send(target.message(self._vehicle.system, self._state.home_offset))

    async def _cancel_order(self, order: Order) -> None:
        """Cancels the goal in the autopilot, which would follow it once the obstacle is gone.

        A landing or a return continues, since no other action is safer.
        """
        if order.has_destination:
            with suppress(DeviceError):
                await self.hold()

    async def check_underway(self, action: str, order: Order, start: float) -> None:
        """Raises DeviceError under foreign control, but not if a failsafe also lands or returns."""
        if self._stopped:
            raise self._vehicle.error(f"{action} was stopped: {self._stopped}")
        state = self._state
        is_overridden = self.failsafe.is_engaged and order.has_destination
        if state.armed and state.mode in order.modes and not is_overridden:
            return
        await self.failsafe.await_text()
        cause = ", which its failsafe chose" if self.failsafe.is_engaged else self.monitor.commanded_by
        reason = f"the vehicle went to {state.mode}{cause}" if state.armed else "the motors are off"
        raise self._vehicle.error(f"{action} ended early: {reason}{self._vehicle.reasons(start)}")

    async def slow_down(self, speed: float, reason: str) -> None:
        """Slows the vehicle down or, if setpoints contain the speed, holds. Raises DeviceError."""
        await (self.speed.slow_down(speed) if self.speed.can_slow_down else self.halt(reason))
