"""How a motion is begun, kept up, watched and given up, and whose vehicle it is."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress

from lfield.driver import DeviceError
from lfield_mavlink.contact.contact import SHOWS, Contact
from lfield_mavlink.geo import Vector
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import AUTONOMOUS
from lfield_mavlink.monitors.flight_monitor import FlightMonitor
from lfield_mavlink.parts.failsafe import Failsafe
from lfield_mavlink.parts.fences import OwnFence
from lfield_mavlink.parts.progress import Arrival, Progress
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.setpoints.guided_mode import GuidedMode, Hover
from lfield_mavlink.setpoints.orders import Order, Patience, Stack, orders_for, reposition
from lfield_mavlink.setpoints.speed import Speed
from lfield_mavlink.setpoints.stream import SetpointStream
from lfield_mavlink.setpoints.trajectory import Stay, Target, Trajectory, stopping_place

#: Of what flies to a goal, and of what drives there.
ON_ITS_WAY, DRIVES = Patience(), Patience(turning=40.0, detour=30.0)
#: m/s above which it moves, unless it is told a low speed: then the share of that, and what is always noise.
MOVES, SHARE, NOISE = 0.3, 0.5, 0.05
#: Seconds after which one that does not move is asked why, and without a position a moving target waits.
ASKED_WHY, PLACED = 2.0, 0.5
#: Seconds out of OFFBOARD after which no trajectory is followed: a packet of before may come late.
LEFT = 0.7
#: m/s over ground with which a stop is followed.
STAYS_AT = 1.0


class Motion:
    """Modes and motions of one vehicle, for the parts whose instructions move it."""

    def __init__(self, vehicle: Contact, parameters: Parameters) -> None:
        self._vehicle, self._state, self._parameters = vehicle, vehicle.state, parameters
        self.fence, self.failsafe = OwnFence(vehicle, parameters), Failsafe(vehicle)
        self.monitor = FlightMonitor(vehicle, parameters)
        self.monitor.is_ours = lambda: self.ours
        self.stream = SetpointStream(vehicle.clock, self.send, self._where, self._is_followed)
        self.speed = Speed(vehicle, self.stream, parameters)
        self.guided, self.hover = GuidedMode(vehicle), Hover(vehicle)
        self.tolerance: float = vehicle.binding.option("tolerance")
        # The modes that the last order leads to; any other mode is somebody else's doing.
        self._commanded: frozenset[str] = frozenset()
        # When the last motion was begun, and why it was stopped by this driver.
        self._began, self._stopped = -math.inf, ""
        # Since when it is not in OFFBOARD any more, None while it is, or is about to enter it.
        self._left_at: float | None = None
        self._was_in_guided = False
        vehicle.on(dialect.MAVLINK_MSG_ID_HEARTBEAT, self._on_mode)
        vehicle.on(dialect.MAVLINK_MSG_ID_CURRENT_MODE, self._on_mode)

    @property
    def orders(self) -> Stack:
        """What this autopilot must be sent for a motion."""
        return orders_for(self._vehicle.profile)

    # -- modes ----------------------------------------------------------------------------------------

    @property
    def ours(self) -> bool:
        """Whether this program led to the mode, not a failsafe; of a vehicle at rest it does not matter."""
        if self.failsafe.has_it or self.monitor.foreign or not self._state.armed:
            return not self._state.armed
        profile = self._vehicle.profile
        # What it does by itself ends on the ground; in the air, or instead of setpoints, somebody chose it.
        by_itself = self._state.landed if profile.flies else self._commanded != {profile.guided}
        own = profile.own if by_itself else ()
        return self._state.mode in (profile.guided, *own, *self._commanded)

    def claim(self, *modes: str) -> None:
        """These modes are what this program led to, and no others."""
        self._commanded = frozenset(modes)

    def release(self) -> None:
        """Whatever mode it is in, and whoever chose it, is this program's from now on."""
        self.failsafe.release()
        self.monitor.release()
        self.claim(self._state.mode)

    def begin(self, what: str) -> None:
        """A new motion ends the last one. Raises DeviceError when the vehicle is not ours to move."""
        self._vehicle.check_link()
        self._vehicle.check_identity()
        if not self.ours:
            why = self.monitor.foreign or (
                f"the vehicle is in {self._state.mode}, which this program did not choose; "
                f"{self.failsafe.holding}"
            )
            raise self._vehicle.error(f"{what} refused: {why}. release() takes it back")
        self.monitor.check_begin(what)
        self._vehicle.take_charge()
        self._began, self._stopped = self._vehicle.clock.monotonic(), ""
        self.speed.begin()
        self.brake()

    async def halt(self, why: str) -> None:
        """Hold, whatever is under way; the motion that this ends says why. Raises DeviceError."""
        self._stopped = why
        self.brake()
        await self.hold()

    async def hold(self) -> None:
        """Stop, and stay there: in the mode for that, or PX4's copter by setpoints. Raises DeviceError.

        In its own mode for staying PX4 would stay as long as any ground station is heard.
        """
        profile, place = self._vehicle.profile, self._resting_place
        if profile.by_trajectory and profile.flies and place is not None and self._state.landed is False:
            # Without a position, say: then its own mode is what is left.
            with suppress(DeviceError):
                await self.start("hold", Order(frozenset({profile.guided}), trajectory=Stay(place, STAYS_AT)))
                return
        await self.set_mode(profile.hold)
        self.hover.begin()

    def brake(self) -> None:
        """Have no motion go on: PX4's copter stops by the setpoints that it needs anyway."""
        place, profile = self._resting_place, self._vehicle.profile
        if place and self.stream.runs and self._is_fed and profile.by_trajectory and profile.flies:
            self._begin_stream(Stay(place, STAYS_AT))
        else:
            self.stream.stop()

    @property
    def _resting_place(self) -> Vector | None:
        """Where it comes to rest when it brakes now, in metres of home; None where that is not known."""
        place = self._state.position
        known = place is not None and self._state.home is not None and self._state.armed
        known = known and not (self.monitor.lost_position or self.monitor.foreign)
        return stopping_place(place, self._state.velocity) if known and place is not None else None

    async def set_mode(self, name: str) -> None:
        """Any mode that the vehicle has; the one for staying stops it. Raises DeviceError."""
        self.speed.forget_slowing()
        if name != self._vehicle.profile.hold or not await self._stays():
            values = self._vehicle.profile.mode_command(name)
            await self.enter(f"mode {name}", name, dialect.MAV_CMD_DO_SET_MODE, *values)

    async def _stays(self) -> bool:
        """Send PX4 to where it can stop, if it may be flying a goal; whether it was, and took that.

        It flies to a goal of a ground station in the very mode for staying, and goes on to it when that mode
        is commanded again.
        """
        profile, state, place = self._vehicle.profile, self._state, self._resting_place
        if not profile.px4 or state.mode != profile.hold or place is None:
            return False
        fed = self._is_fed
        try:
            await self._begin("hold", reposition(state, place, None))
        except DeviceError:
            return False
        if fed:
            values = profile.mode_command(profile.hold)
            await self.failsafe.did_the_same("hold", dialect.MAV_CMD_DO_SET_MODE, *values)
        self.stream.stop()
        return True

    async def enter(
        self,
        what: str,
        mode: str,
        command: int,
        *values: float,
        done: Callable[[], bool] = lambda: False,
    ) -> None:
        """Enter a mode by a command that leads to it, or see that it is `done`. Raises DeviceError."""
        self.hover.end()
        self.monitor.on_mode(mode)
        # Noted before it is known to have worked: a safe state that is tried again must count as ours, and so
        # must the mode that it is still in when the new one is refused.
        self._commanded |= {mode}
        fed = self._is_fed
        await self._vehicle.achieve(
            what, lambda: self._state.mode == mode or done(), command, *values, mode=mode
        )
        if fed:
            await self.failsafe.did_the_same(what, command, *values)
        if mode != self._vehicle.profile.guided:
            self.stream.stop()
        self.claim(mode)

    # -- motions --------------------------------------------------------------------------------------

    async def start(self, what: str, order: Order, taken: Callable[[], bool] | None = None) -> None:
        """Begin an order: mode, command or setpoints, the mode they lead to, and its speed.

        Raises DeviceError, also when PX4 does it by itself and the binding does not waive that.
        """
        if order.command is not None and self._vehicle.profile.px4:
            self._check_waived(what, f"PX4 flies {' or '.join(sorted(order.modes))} by itself")
        await self._begin(what, order, taken)

    async def _begin(self, what: str, order: Order, taken: Callable[[], bool] | None = None) -> None:
        if order.mode and self._state.mode != order.mode:
            await self.set_mode(order.mode)
        self.monitor.on_order(order)
        # As in `enter`: until the new order is seen, the mode it is still in is ours too.
        self._commanded |= order.modes
        if (command := order.command) is not None:
            self.speed.begin_command()
            await self._vehicle.command(
                what, command.number, *command.values, place=command.place, taken=taken
            )
        if order.trajectory is not None:
            await self._follow(what, order.trajectory)
        await self._vehicle.until(lambda: self._state.mode in order.modes, SHOWS, what)
        self.claim(*order.modes)
        await self.speed.fly_at(order.speed if order.command is None else None, self.send)

    def check_bounded(self, what: str, mode: str) -> None:
        """Refuse a mode that no failsafe ends when this computer dies, unless the binding waives that.

        The binding's safe state and a landing may continue then; a hover may not. Raises DeviceError.
        """
        profile, binding = self._vehicle.profile, self._vehicle.binding
        bounded = {profile.land, profile.safe(binding.safe_state)}
        if not profile.flies or self._state.landed is not False:
            bounded.add(profile.hold)
        if mode in profile.autonomous - bounded:
            self._check_waived(what, f"PX4 flies {mode} by itself")
        if mode in profile.piloted - bounded and self._state.landed is False:
            self._check_waived(what, f"the failsafe of ArduCopter leaves {mode} to a pilot")

    def _check_waived(self, what: str, why: str) -> None:
        if not self._vehicle.binding.waives(AUTONOMOUS):
            raise self._vehicle.error(
                f"{what} refused: {why}, and would go on when this computer dies, also beside another "
                f"ground station. Use goTo, orbit, hold and land, or accept it by 'waivers: "
                f"{{{AUTONOMOUS}: REASON}}' in its binding"
            )

    async def _follow(self, what: str, trajectory: Trajectory) -> None:
        """Have PX4 follow a moving target, and see that it does. Raises DeviceError."""
        self._begin_stream(trajectory)
        try:
            until = self._vehicle.clock.monotonic() + SHOWS
            await self.guided.enter_offboard(what, until, f"{SHOWS:g} s")
        except BaseException:
            self.stream.stop()
            raise

    def _begin_stream(self, trajectory: Trajectory) -> None:
        self._left_at, self._was_in_guided = None, self._is_fed
        self.stream.follow(trajectory)

    def _where(self) -> tuple[Vector | None, Vector]:
        """Where it is, None where that is not known any more, and its velocity."""
        state, now = self._state, self._vehicle.clock.monotonic()
        return state.position if now - state.placed_at <= PLACED else None, state.velocity

    def _is_followed(self) -> bool:
        """Whether the moving target is still to be sent: not when somebody else has it, or it is off."""
        stays = self._left_at is None or self._vehicle.clock.monotonic() - self._left_at < LEFT
        return self._state.armed and stays and not self.monitor.foreign

    @property
    def _is_fed(self) -> bool:
        """Whether PX4 waits for setpoints, also where it has accepted that and has not shown it yet."""
        return self._vehicle.profile.px4 and (self.guided.is_entered or self.guided.is_believed)

    def _on_mode(self, _: object) -> None:
        """Note when it leaves OFFBOARD, once it was in it."""
        if self._state.profile is None or self.stream.trajectory is None:
            return
        if self.guided.is_entered:
            self._left_at, self._was_in_guided = None, True
        elif self._was_in_guided and self._left_at is None:
            self._left_at = self._vehicle.clock.monotonic()

    async def travel(
        self,
        what: str,
        order: Order,
        distance: Callable[[Vector], float],
        near: float,
        patience: Patience = ON_ITS_WAY,
    ) -> None:
        """Wait until `distance` of the position is at most `near`, as long as it gets less.

        Raises DeviceError.
        """
        try:
            await self._travel(what, order, distance, near, patience)
        except BaseException:
            # Failed or called off: nobody waits for it any more.
            if order.trajectory is not None and self.stream.trajectory is order.trajectory:
                self.brake()
            raise

    async def _travel(
        self, what: str, order: Order, distance: Callable[[Vector], float], near: float, patience: Patience
    ) -> None:
        vehicle = self._vehicle
        start = vehicle.clock.monotonic()
        progress, sent_at, asked = Progress(patience, start, self._state.position), -math.inf, False
        while True:
            now = vehicle.clock.monotonic()
            vehicle.check_link()
            place = self._state.position
            left = distance(place) if place is not None else math.inf
            if left <= near:
                return
            await self.monitor.check(what, order, left)
            await self._check_underway(what, order, start)
            if progress.is_over(left, self.moves, now, self.speed.of_motion, place):
                await self._give_up(order)
                seconds = patience.bound(self.moves, self.speed.of_motion)
                words = patience.words.format(seconds=seconds, left=left, room=patience.room)
                fence = await self.fence.perhaps() if order.goal is not None else ""
                raise vehicle.error(f"{what} gave up: {words}{fence}")
            if not asked and self._is_refused(order, progress, now):
                asked = True
                await self._check_fence(what, order)
            if order.target is not None and place is not None and now - sent_at >= order.period:
                self.send(order.target(place))
                sent_at = now
            await vehicle.next_news(min(0.25, order.period))

    @property
    def patience(self) -> Patience:
        """How long it may come no closer to a place."""
        return ON_ITS_WAY if self._vehicle.profile.flies else DRIVES

    @property
    def moves(self) -> bool:
        """Whether it moves over ground or up and down, as far as it tells."""
        pace = self.speed.of_motion
        least = MOVES if pace is None else max(min(MOVES, SHARE * pace), NOISE)
        return self._state.speeds is not None and math.hypot(*self._state.speeds) > least

    def _is_refused(self, order: Order, progress: Progress, now: float) -> bool:
        """Whether it looks as if the autopilot does not want to go there."""
        told = "geofence" in self._vehicle.reasons(self._began)
        return order.goal is not None and (told or progress.stood(now) > ASKED_WHY)

    async def _check_fence(self, what: str, order: Order) -> None:
        """Raise DeviceError when its own fence is why it does not move."""
        assert order.goal is not None, "the caller has looked"
        told = self._vehicle.reasons(self._began)
        why = await self.fence.why_beyond(order.goal)
        if why or "geofence" in told:
            await self._give_up(order)
            raise self._vehicle.error(f"{what} refused: {why or 'the goal is outside its own fence'}{told}")

    async def arrival(self) -> Arrival:
        """How what drives arrives: ArduPilot stops a rover within its WP_RADIUS of a goal."""
        profile, radius = self._vehicle.profile, 0.0
        if profile.kind == "rover" and not profile.px4:
            radius = await self._parameters.read("WP_RADIUS") or 0.0
        return Arrival(radius, lambda: self.moves, self._vehicle.clock.monotonic)

    def send(self, target: Target) -> None:
        """Send a setpoint, in the autopilot's local frame."""
        self.speed.sent(target)
        self.monitor.on_sent(target)
        self._vehicle.send(target.message(self._vehicle.system, self._state.home_offset))

    async def _give_up(self, order: Order) -> None:
        """Have the autopilot give up too, or the goal would be followed on when what is in its way has gone.

        A landing or a return goes on: there is nothing safer to do instead.
        """
        if order.leads:
            with suppress(DeviceError):
                await self.hold()

    async def _check_underway(self, what: str, order: Order, start: float) -> None:
        """Raise when somebody else has taken over, or the motors are off, with what is said of that.

        A landing or a return goes on when a failsafe wants the same.
        """
        if self._stopped:
            raise self._vehicle.error(f"{what} was stopped, since {self._stopped}")
        state = self._state
        taken = self.failsafe.has_it and order.leads
        if state.armed and state.mode in order.modes and not taken:
            return
        await self.failsafe.explains()
        chosen = ", which its failsafe chose" if self.failsafe.has_it else self.monitor.commanded_by
        why = f"the vehicle went to {state.mode}{chosen}" if state.armed else "the motors are off"
        raise self._vehicle.error(f"{what} ended early: {why}{self._vehicle.reasons(start)}")

    async def slow_down(self, speed: float, why: str) -> None:
        """Have it fly slower, or, where setpoints say how fast, hold. Raises DeviceError."""
        if self.speed.can_slow_down:
            await self.speed.slow_down(speed)
        else:
            await self.halt(why)
