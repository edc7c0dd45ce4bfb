"""Base class of one servo (a group of one) and a group: opens, monitors, holds and releases the members."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Sequence
from contextlib import suppress
from typing import TypeVar

from msgspec.structs import replace

from lfield.driver import Clock, Device, DeviceBinding, DeviceError, Manifest, Reports, Setting
from lfield_dynamixel import log_messages
from lfield_dynamixel.bus.half_duplex_bus import COMMAND, POLL, SAFETY
from lfield_dynamixel.bus.packets import Status
from lfield_dynamixel.bus.servo_chain import FEWEST_ROUNDS, Chain, Node
from lfield_dynamixel.joints.calibration import OPTION
from lfield_dynamixel.joints.mounting import ids_of, joints_of
from lfield_dynamixel.servo import WATCHDOG_FIRED, Condition, Present, Servo, condition
from lfield_dynamixel.stored_settings import settings_of, write_setting

#: Polls per reading of the conditions.
CONDITIONS_EVERY = 10
#: Polls per id check of one member, in turn.
ID_CHECK_EVERY = 20
#: Seconds between two requests to a member that does not answer.
PROBE = 0.5
#: rad/s below which a servo is at rest, and seconds for a stop.
STILL, STOP = 0.1, 2.0
#: An older position (s) is not used to hold a silent servo.
MAX_AGE = 0.3
#: Seconds without a reading of a member, such as on a muted bus, after which it counts as silent.
SILENT = 1.0
#: Seconds between two checks of a condition.
POLL_INTERVAL = 0.02

Readings = dict[int, Present]
T = TypeVar("T")


class Members(Device):
    """The servos of one device. Subclasses override `publish_readings`."""

    #: Far beyond every register.
    largest = 1e12

    def __init__(
        self, binding: DeviceBinding, manifest: Manifest, clock: Clock, reports: Reports, chain: Chain
    ) -> None:
        super().__init__(binding, manifest, clock, reports)
        self.chain = chain
        self.profile = (0.0, 0.0)
        self.servos: dict[int, Servo] = {}
        self.conditions: dict[int, Condition] = {}
        self._readings: dict[int, tuple[float, Present]] = {}
        self._probe_at: dict[int, float] = {}
        self._watchdog: float | None = None
        self._polls = 0
        #: Members whose id two servos have, with the description.
        self.conflicts: dict[int, str] = {}
        self.opened = False

    def publish_readings(self, readings: Readings) -> None:
        """Publishes the measured values of the members."""
        raise NotImplementedError

    # -- opening ----------------------------------------------------------------------------------------

    async def _open(self) -> str:
        protocol, joints = self.binding.option("protocol"), joints_of(self.binding)
        if not joints:
            raise self.error("its binding names no servo: write 'ids: [1, 2, 3]'")
        servos = [Servo(self.chain, Node(number, protocol), joint) for number, joint in joints.items()]
        model = self.binding.option("model")
        identities = await self.for_each(servos, lambda servo: servo.open(model))
        self.servos = dict(zip(joints, servos, strict=True))
        self.publish_readings(await self.observe())
        await self.read_conditions()
        self.opened = True
        return ", ".join(identities)

    def _touched(self) -> bool:
        """Whether the watchdog was set, which releases a servo stopped by it; before that, opening only
        reads.
        """
        return self._watchdog is not None

    @property
    def last_readings(self) -> Readings:
        return {number: value for number, (_, value) in self._readings.items()}

    @property
    def numbers(self) -> list[int]:
        """The ids in the binding."""
        return ids_of(self.binding)

    async def _set_watchdog(self, longest: float) -> float | None:
        self._watchdog = longest
        times = await self.for_each(self.servos.values(), lambda servo: servo.set_watchdog(longest))
        return None if None in times else max(time for time in times if time is not None)

    async def _settings(self) -> Sequence[Setting]:
        return await settings_of(self.servos.values(), str(self.binding.options.get(OPTION, "")))

    async def _write_setting(self, name: str, value: float) -> None:
        await write_setting(self.servos, name, int(value))

    def _in_use(self) -> str:
        return "its torque is on" if any(condition.torque for condition in self.conditions.values()) else ""

    async def do_release(self) -> None:
        """The program takes control again: members stopped by their watchdog follow goals again."""
        await self.for_each(self.servos.values(), self._revive)

    async def do_reboot(self) -> None:
        """Restarts the members, and sets them up as at opening."""
        await self.for_each(self.servos.values(), self._reboot)
        await self.read_conditions()

    async def _reboot(self, servo: Servo) -> None:
        if servo.node.protocol != 2:
            raise servo.error("does not support reboot (only protocol 2.0 does): switch its power off and on")
        await self.chain.reboot(servo.node)
        for _ in range(30):
            await asyncio.sleep(0.1)
            if await self.chain.ping(servo.node) is not None:
                break
        await self._revive(servo)
        await servo.read_settings()

    async def _revive(self, servo: Servo) -> None:
        """Restores a servo's goals and watchdog, if it has expired or was lost without power."""
        if not servo.model.watchdog or self._watchdog is None:
            return
        if (await servo.condition()).watchdog in (0, WATCHDOG_FIRED):
            await servo.set_watchdog(self._watchdog)

    # -- monitoring -------------------------------------------------------------------------------------

    async def poll(self) -> None:
        """Polls the members once and publishes the readings; failures are logged, not raised."""
        observed = await self.observe(urgency=POLL)
        self.publish_readings(observed)
        self._polls += 1
        if self._polls % CONDITIONS_EVERY == 0 or any(value.alert for value in observed.values()):
            await self.read_conditions()
        if self._polls % ID_CHECK_EVERY == 0 and (answering := self._answering_members()):
            await self.check_for_double(answering[self._polls // ID_CHECK_EVERY % len(answering)])

    async def observe(self, *, urgency: int = COMMAND, alone: bool = True) -> Readings:
        """The readings of members that answer. Silent members are asked at intervals only."""
        queried = await self._present_members(urgency) if alone else list(self.servos.values())
        answers = await self._read(queried, "present", urgency, alone=alone)
        observed = {number: self.servos[number].reading(status) for number, status in answers.items()}
        now = self.clock.monotonic()
        self._readings.update({number: (now, value) for number, value in observed.items()})
        if alone:
            for servo in queried:
                if servo.node.number not in observed:
                    self._on_missing(servo)
        if observed:
            self.heard()
        return observed

    async def _read(
        self, servos: list[Servo], area: str, urgency: int, *, alone: bool = True
    ) -> dict[int, Status]:
        """Reads a range of the control tables (`present` or `state`) of several servos, by id."""
        answers: dict[int, Status] = {}
        for span in {getattr(servo.model, area) for servo in servos}:
            nodes = [servo.node for servo in servos if getattr(servo.model, area) == span]
            answers |= await self.chain.sync_read(nodes, *span, urgency=urgency, alone=alone)
        return answers

    async def _present_members(self, urgency: int) -> list[Servo]:
        """The members known to answer; silent ones are tried again at intervals."""
        present = []
        for number, servo in self.servos.items():
            if self._probe_at.get(number, 0.0) > self.clock.monotonic():
                continue
            if number in self._probe_at:
                answers = await self.chain.ping(servo.node, urgency=urgency) is not None
                if not answers or await self._is_doubled(servo, urgency):
                    self._on_missing(servo)
                    continue
                del self._probe_at[number]
                await self._note_return(servo)
            present.append(servo)
        return present

    async def check_for_double(self, servo: Servo) -> None:
        """Stops all members when another servo has joined with the id of a member."""
        if not await self._is_doubled(servo, POLL, fewest=1):
            return
        with suppress(DeviceError):  # those that receive it stop
            await self._stop()
        number = servo.node.number
        self._probe_at[number] = self.clock.monotonic() + PROBE
        self.conditions.pop(number, None)
        self._publish_conditions()

    async def _is_doubled(self, servo: Servo, urgency: int, fewest: int = FEWEST_ROUNDS) -> bool:
        """Whether another servo with the same id has joined; logged once."""
        number, place = servo.node.number, servo.model.present
        conflict = await self.chain.id_conflict(servo.node, *place, urgency=urgency, fewest=fewest)
        if conflict and number not in self.conflicts:
            self.note(log_messages.ID_CONFLICT.line(reason=conflict))
        self.conflicts.pop(number, None)
        if conflict:
            self.conflicts[number] = conflict
        return bool(conflict)

    def _on_missing(self, servo: Servo) -> None:
        """Logs once that a member does not answer."""
        number = servo.node.number
        if number not in self._probe_at:
            self.note(log_messages.SERVO_SILENT.line(number=servo.joint.label))
        self._probe_at[number] = self.clock.monotonic() + PROBE
        self.conditions.pop(number, None)
        self._publish_conditions()

    async def _note_return(self, servo: Servo) -> None:
        reason = await self._return_reason(servo)
        self.note(log_messages.SERVO_BACK.line(number=servo.joint.label, condition=reason))

    async def _return_reason(self, servo: Servo) -> str:
        """The condition of a servo after its silence. Without power it has lost its watchdog setting."""
        try:
            state = await servo.condition(urgency=POLL)
            torque = "torque on" if state.torque else "torque off"
            if state.watchdog == WATCHDOG_FIRED:
                return f"{torque}, stopped by its watchdog until release()"
            if servo.model.watchdog and state.watchdog == 0 and self._watchdog is not None:
                await servo.read_settings()
                await servo.set_watchdog(self._watchdog)
                return f"{torque}, restarted"
        except DeviceError as error:
            return error.reason
        return torque

    def _answering_members(self) -> list[Servo]:
        """The members that answered last time."""
        return [servo for number, servo in self.servos.items() if number not in self._probe_at]

    async def read_conditions(self) -> None:
        """Reads the conditions of answering members, and publishes them."""
        answers = await self._read(self._answering_members(), "state", COMMAND)
        for number, status in answers.items():
            servo, previous = self.servos[number], self.conditions.get(number)
            current = self.conditions[number] = condition(servo.model, status)
            label = servo.joint.label
            if current.faults and (previous is None or previous.faults != current.faults):
                torque = "reduced" if current.weak else "on" if current.torque else "off"
                self.note(log_messages.FAULT.line(number=label, fault=current.faults, torque=torque))
            if current.watchdog == WATCHDOG_FIRED and (
                previous is None or previous.watchdog != WATCHDOG_FIRED
            ):
                self.note(log_messages.WATCHDOG_FIRED.line(number=label))
            if (
                current.watchdog == 0
                and previous is not None
                and previous.watchdog not in (0, WATCHDOG_FIRED)
            ):
                await self._note_return(servo)  # its supply voltage has dropped
        self._publish_conditions()

    def _publish_conditions(self) -> None:
        self.publish(
            torqueOn=bool(self.conditions) and all(c.torque for c in self.conditions.values()),
            fault="; ".join(self._fault(n, c) for n, c in self.conditions.items() if c.faults),
        )

    def _fault(self, number: int, condition: Condition) -> str:
        label = self.servos[number].joint.label
        return condition.faults if len(self.servos) == 1 else f"servo {label}: {condition.faults}"

    # -- safe states ------------------------------------------------------------------------------------

    async def _make_safe(self, state: str) -> None:
        start = self.clock.monotonic()
        await self._stop(state)
        if state == "torque_off":
            await self.observe(urgency=SAFETY, alone=False)
            # Earlier readings may be outdated.
            self._readings = {n: reading for n, reading in self._readings.items() if reading[0] >= start}
            return
        await self.for_each(self.servos.values(), self._await_still)

    async def _stop(self, state: str = "") -> None:
        """Commands a safe state ('': that of the binding) to all members."""
        if (state or self.safe_state) == "torque_off":
            await self.release_torque(SAFETY)
            return
        observed = await self.observe(urgency=SAFETY, alone=False)
        await self.send(
            {
                servo: servo.write_of(*servo.hold_goal(place))
                for servo, place in self._places(observed).items()
            }
        )

    async def hold_answering(self) -> None:
        """Commands the members that answer to hold. A silent one may be two servos with one id."""
        observed = await self.observe(urgency=SAFETY)
        places = {s: present for s, present in self._places(observed).items() if s.node.number in observed}
        await self.send({servo: servo.write_of(*servo.hold_goal(place)) for servo, place in places.items()})

    def _moving(self) -> str:
        motions = {number: self._motion_of(number) for number in self.servos}
        is_single = len(self.servos) == 1
        return ", ".join(
            motion if is_single else f"servo {n} {motion}" for n, motion in motions.items() if motion
        )

    def _motion_of(self, number: int) -> str:
        """The motion of one member that is still moving in the safe state; '' when it is at rest."""
        read_at, observed = self._readings.get(number, (0.0, None))
        if observed is None:
            return "does not answer"
        rotation = f"turning at {abs(observed.velocity):.1f} rad/s"
        silence = self.clock.monotonic() - read_at
        if number in self._probe_at or silence > SILENT:
            last_motion = f", last seen {rotation}" if abs(observed.velocity) > STILL else ""
            return f"no message for {silence:.1f} s{last_motion}"
        if abs(observed.velocity) > STILL:
            return rotation
        condition = self.conditions.get(number)
        if self.safe_state == "torque_off" and condition is not None and condition.torque:
            # Another master on the bus has switched the torque on.
            return "torque on again"
        return ""

    async def release_torque(self, urgency: int) -> None:
        """Switches every torque off by one packet, then confirms each."""

        async def confirm(servo: Servo) -> None:
            servo.set_pushing(False)
            if await servo.read_item("torque_enable", urgency=urgency):
                await servo.write_item("torque_enable", 0, urgency=urgency)
            if condition := self.conditions.get(servo.node.number):
                self.conditions[servo.node.number] = replace(condition, torque=False)

        await self.send({s: (s.item("torque_enable").address, b"\0") for s in self.servos.values()}, urgency)
        await self.for_each(self.servos.values(), confirm)
        self._publish_conditions()

    def _places(self, readings: Readings) -> dict[Servo, Present]:
        """The position at which each member must hold; the last position for a member that does not answer.

        A member that holds an object by its force continues to do so.
        """
        now = self.clock.monotonic()
        recent = {n: value for n, (read_at, value) in self._readings.items() if now - read_at <= MAX_AGE}
        places = {self.servos[number]: value for number, value in (recent | readings).items()}
        return {s: value for s, value in places.items() if not (s.pushing or self._is_limp(s))}

    def _is_limp(self, servo: Servo) -> bool:
        """Whether a servo is known to be limp: a goal would switch an AX on."""
        condition = self.conditions.get(servo.node.number)
        return condition is not None and not condition.torque

    async def send(self, writes: dict[Servo, tuple[int, bytes]], urgency: int = SAFETY) -> None:
        """Writes to several servos at once, one packet per address; also reaches those that cannot answer."""
        for address in sorted({address for address, _ in writes.values()}):
            data = {s.node.number: part for s, (at, part) in writes.items() if at == address}
            protocol = next(iter(writes)).node.protocol
            await self.chain.sync_write(address, data, protocol=protocol, urgency=urgency)

    async def _await_still(self, servo: Servo) -> None:
        """Confirms that a servo has stopped: its goal is its position, or it cannot turn."""
        condition = await servo.condition(urgency=SAFETY)
        if condition.torque and condition.watchdog != WATCHDOG_FIRED and not servo.pushing:
            name, goal = servo.hold_goal(await servo.present(urgency=SAFETY))
            # A slightly older goal is valid; one that is far off never reached the servo.
            tolerance = STILL / servo.model.position if name == "goal_position" else 0.0
            if abs(await servo.read_item(name, urgency=SAFETY) - goal) > tolerance:
                await servo.write_item(name, goal, urgency=SAFETY)
        deadline, still_readings = self.clock.monotonic() + STOP, 0
        while still_readings < 2:
            observed = await servo.present(urgency=SAFETY)
            self._readings[servo.node.number] = (self.clock.monotonic(), observed)
            still_readings = still_readings + 1 if abs(observed.velocity) <= STILL else 0
            if not still_readings and self.clock.monotonic() > deadline:
                raise servo.error(f"still turns, at {observed.velocity:.2f} rad/s")
            await asyncio.sleep(POLL_INTERVAL)

    # -- parts ------------------------------------------------------------------------------------------

    async def for_each(self, servos: Iterable[Servo], operation: Callable[[Servo], Awaitable[T]]) -> list[T]:
        """Runs `operation` for every servo. Raises DeviceError with all failures afterwards."""
        results, errors = [], []
        for servo in servos:
            try:
                results.append(await operation(servo))
            except DeviceError as error:
                errors.append(error)
        if errors:
            is_timeout = all(error.kind == "DeviceTimeoutException" for error in errors)
            raise self.error("; ".join(error.reason for error in errors), timeout=is_timeout)
        return results
