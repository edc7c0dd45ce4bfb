"""What one servo and a group have in common: members that are found, watched, held and let go.

A single servo is a group of one. Whatever is done to several is done to each, and what failed is told at the
end, by name: one that is dead keeps nobody else from being made safe.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

from lfield.driver import Clock, Device, DeviceBinding, DeviceError, Manifest, Reports, Setting
from lfield_dynamixel.bus.bus import COMMAND, POLL, SAFETY
from lfield_dynamixel.bus.chain import FEWEST_ROUNDS, Chain, Node
from lfield_dynamixel.bus.packets import Status
from lfield_dynamixel.servo import ALL, ANSWERS, FIRED, Condition, Present, Servo, condition, present

#: Every so many polls the conditions are read too.
CONDITIONS_EVERY = 10
#: Every so many polls one member, in turn, is asked whether another servo has joined with its id.
ROLL_CALL_EVERY = 20
#: Seconds between two looks for a member that does not answer.
PROBE = 0.5
#: rad/s below which a servo stands still, and seconds that a stop may take.
STILL, STOP = 0.1, 2.0
#: A position that is older than this (s) is not where a silent servo is told to stay.
FRESH = 0.3
#: Seconds without a look at a member, as when the bus is gone or quiet, after which it is not heard.
SILENT = 1.0
#: Seconds between two looks at a state that is waited for.
LOOK = 0.02

Seen = dict[int, Present]
T = TypeVar("T")


class Members(Device):
    """The servos of one device. Authors of a device type override `tell`."""

    def __init__(
        self, binding: DeviceBinding, manifest: Manifest, clock: Clock, reports: Reports, chain: Chain
    ) -> None:
        super().__init__(binding, manifest, clock, reports)
        self.chain = chain
        self.profile = (0.0, 0.0)
        self.servos: dict[int, Servo] = {}
        self.conditions: dict[int, Condition] = {}
        self._seen: dict[int, tuple[float, Present]] = {}
        self._probe_at: dict[int, float] = {}
        self._watchdog: float | None = None
        self._polls = 0
        #: Members whose id two servos have, with what is told of it.
        self.conflicts: dict[int, str] = {}
        self.opened = False

    def tell(self, seen: Seen) -> None:
        """Publish what the members measure."""
        raise NotImplementedError

    # -- opening ----------------------------------------------------------------------------------------

    async def _open(self) -> str:
        protocol, numbers = self.binding.option("protocol"), self.numbers
        if not numbers:
            raise self.error("its binding names no servo: write 'ids: [1, 2, 3]'")
        servos = [Servo(self.chain, Node(number, protocol)) for number in numbers]
        model = self.binding.option("model")
        identities = await self.each(servos, lambda servo: servo.open(model))
        self.servos = dict(zip(numbers, servos, strict=True))
        self.tell(await self.observe())
        await self.look()
        self.opened = True
        return ", ".join(identities)

    def _touched(self) -> bool:
        """It is read until its watchdog is set: that lets a servo which was stopped by it go on."""
        return self._watchdog is not None

    @property
    def last_seen(self) -> Seen:
        """What each member measured when it was last looked at."""
        return {number: value for number, (_, value) in self._seen.items()}

    @property
    def numbers(self) -> list[int]:
        """The ids in the binding."""
        options = self.binding.options
        return list(self.binding.option("ids")) if "ids" in options else [self.binding.option("id")]

    async def _set_watchdog(self, longest: float) -> float | None:
        self._watchdog = longest
        times = await self.each(self.servos.values(), lambda servo: servo.set_watchdog(longest))
        return None if None in times else max(time for time in times if time is not None)

    async def _settings(self) -> Sequence[Setting]:
        """What servos answer, where they keep it; a write that is not answered cannot be confirmed."""
        return [
            Setting(name, await servo.get(ANSWERS), ALL, "it answers writes")
            for name, servo in self._keepers().items()
        ]

    async def _write_setting(self, name: str, value: float) -> None:
        servo = self._keepers()[name]
        if value == ALL:
            await servo.answer_all()
        else:
            await self.chain.write(
                servo.node, servo.item(ANSWERS).address, servo.item(ANSWERS).encode(int(value))
            )

    def _keepers(self) -> dict[str, Servo]:
        """The members that keep what they answer, by the name of that setting."""
        keepers = [servo for servo in self.servos.values() if servo.keeps_answers]
        return {f"{ANSWERS} of servo {servo.node.number}": servo for servo in keepers}

    def _in_use(self) -> str:
        return "its torque is on" if any(now.torque for now in self.conditions.values()) else ""

    async def do_release(self) -> None:
        """The owner takes the device back: members that their watchdog has stopped follow goals again."""
        await self.each(self.servos.values(), self._revive)

    async def do_reboot(self) -> None:
        """Restart the members, and set them up as at opening."""
        await self.each(self.servos.values(), self._reboot)
        await self.look()

    async def _reboot(self, servo: Servo) -> None:
        if servo.node.protocol == 1:
            raise servo.error("knows no reboot (protocol 1.0): switch its power off and on")
        await self.chain.reboot(servo.node)
        for _ in range(30):
            await asyncio.sleep(0.1)
            if await self.chain.ping(servo.node) is not None:
                break
        await self._revive(servo)
        await servo.read_settings()

    async def _revive(self, servo: Servo) -> None:
        """Have a servo follow goals with its watchdog set, where it fired or forgot it without power."""
        if not servo.model.watchdog or self._watchdog is None:
            return
        if (await servo.condition()).watchdog in (0, FIRED):
            await servo.set_watchdog(self._watchdog)

    # -- watching ---------------------------------------------------------------------------------------

    async def poll(self) -> None:
        """One look at the members; publishes it. What fails is told, not raised."""
        seen = await self.observe(urgency=POLL)
        self.tell(seen)
        self._polls += 1
        if self._polls % CONDITIONS_EVERY == 0 or any(value.alert for value in seen.values()):
            await self.look()
        if self._polls % ROLL_CALL_EVERY == 0 and (there := self._there()):
            await self._call_roll(there[self._polls // ROLL_CALL_EVERY % len(there)])

    async def observe(self, *, urgency: int = COMMAND, alone: bool = True) -> Seen:
        """What the members that answer measure now. Who is silent is looked for now and then only."""
        asked = await self._present_members(urgency) if alone else list(self.servos.values())
        answers = await self._read(asked, "present", urgency, alone=alone)
        seen = {n: present(self.servos[n].model, status) for n, status in answers.items()}
        now = self.clock.monotonic()
        self._seen.update({number: (now, value) for number, value in seen.items()})
        if alone:
            for servo in asked:
                if servo.node.number not in seen:
                    self._miss(servo)
        if seen:
            self.heard()
        return seen

    async def _read(
        self, servos: list[Servo], area: str, urgency: int, *, alone: bool = True
    ) -> dict[int, Status]:
        """A range of the control tables (`present` or `state`) of several servos, by id."""
        answers: dict[int, Status] = {}
        for place in {getattr(servo.model, area) for servo in servos}:
            nodes = [servo.node for servo in servos if getattr(servo.model, area) == place]
            answers |= await self.chain.sync_read(nodes, *place, urgency=urgency, alone=alone)
        return answers

    async def _present_members(self, urgency: int) -> list[Servo]:
        """The members that answer as far as is known; whose time has come is looked for."""
        found = []
        for number, servo in self.servos.items():
            if self._probe_at.get(number, 0.0) > self.clock.monotonic():
                continue
            if number in self._probe_at:
                alone = await self.chain.ping(servo.node, urgency=urgency) is not None
                if not alone or await self._is_doubled(servo, urgency):
                    self._miss(servo)
                    continue
                del self._probe_at[number]
                self.note(f"servo {number} answers again: {await self._how_it_is(servo)}")
            found.append(servo)
        return found

    async def _call_roll(self, servo: Servo) -> None:
        """Hold where they are all members, when another servo has joined with the id of one."""
        if not await self._is_doubled(servo, POLL, fewest=1):
            return
        with suppress(DeviceError):  # those that hear it stop
            await self._stop()
        number = servo.node.number
        self._probe_at[number] = self.clock.monotonic() + PROBE
        self.conditions.pop(number, None)
        self._tell_conditions()

    async def _is_doubled(self, servo: Servo, urgency: int, fewest: int = FEWEST_ROUNDS) -> bool:
        """Whether another servo with its id has joined; reported once."""
        number, place = servo.node.number, servo.model.present
        conflict = await self.chain.roll_call(servo.node, *place, urgency=urgency, fewest=fewest)
        if conflict and number not in self.conflicts:
            self.note(conflict)
        self.conflicts.pop(number, None)
        if conflict:
            self.conflicts[number] = conflict
        return bool(conflict)

    def _miss(self, servo: Servo) -> None:
        """A member does not answer; that is told once."""
        number = servo.node.number
        if number not in self._probe_at:
            self.note(f"servo {number} does not answer any more; it is looked for")
        self._probe_at[number] = self.clock.monotonic() + PROBE
        self.conditions.pop(number, None)
        self._tell_conditions()

    async def _how_it_is(self, servo: Servo) -> str:
        """What became of a servo while it was silent. One without power has forgotten its watchdog."""
        try:
            now = await servo.condition(urgency=POLL)
            torque = "torque on" if now.torque else "torque off"
            if now.watchdog == FIRED:
                return f"{torque}, stopped by its watchdog until release()"
            if servo.model.watchdog and now.watchdog == 0 and self._watchdog is not None:
                await servo.read_settings()
                await servo.set_watchdog(self._watchdog)
                return f"{torque}, restarted"
        except DeviceError as error:
            return error.reason
        return torque

    def _there(self) -> list[Servo]:
        """The members that answered last time."""
        return [servo for number, servo in self.servos.items() if number not in self._probe_at]

    async def look(self) -> None:
        """Read the conditions of the members that answer, and publish them."""
        answers = await self._read(self._there(), "state", COMMAND)
        for number, status in answers.items():
            new, old = condition(self.servos[number].model, status), self.conditions.get(number)
            self.conditions[number] = new
            if new.faults and (old is None or old.faults != new.faults):
                self.note(f"servo {number}: {new.faults}; the torque is {'on' if new.torque else 'off'}")
            if new.watchdog == FIRED and (old is None or old.watchdog != FIRED):
                self.note(f"servo {number} was stopped by its own watchdog; release() frees it")
        self._tell_conditions()

    def _tell_conditions(self) -> None:
        self.publish(
            torqueOn=bool(self.conditions) and all(c.torque for c in self.conditions.values()),
            fault="; ".join(self._fault(n, c) for n, c in self.conditions.items() if c.faults),
        )

    def _fault(self, number: int, condition: Condition) -> str:
        return condition.faults if len(self.servos) == 1 else f"servo {number}: {condition.faults}"

    # -- safe states ------------------------------------------------------------------------------------

    async def _make_safe(self, state: str) -> None:
        begun = self.clock.monotonic()
        await self._stop(state)
        if state == "torque_off":
            await self.observe(urgency=SAFETY, alone=False)
            # What was measured before says nothing of what it does now.
            self._seen = {number: seen for number, seen in self._seen.items() if seen[0] >= begun}
            return
        await self.each(self.servos.values(), self._be_still)

    async def _stop(self, state: str = "") -> None:
        """Command a safe state ('': that of the binding) to all members."""
        if (state or self.safe_state) == "torque_off":
            await self.go_limp(SAFETY)
            return
        seen = await self.observe(urgency=SAFETY, alone=False)
        await self.send({servo: _stay(servo, place) for servo, place in self._places(seen).items()})

    def _moving(self) -> str:
        told = {number: self._still_does(number) for number in self.servos}
        alone = len(self.servos) == 1
        return ", ".join(words if alone else f"servo {n} {words}" for n, words in told.items() if words)

    def _still_does(self, number: int) -> str:
        """What one member still does in the safe state; '' when it is at rest."""
        at, seen = self._seen.get(number, (0.0, None))
        if seen is None:
            return "does not answer"
        turns = f"turning at {abs(seen.velocity):.1f} rad/s"
        silence = self.clock.monotonic() - at
        if number in self._probe_at or silence > SILENT:
            last = f", last seen {turns}" if abs(seen.velocity) > STILL else ""
            return f"not heard for {silence:.1f} s{last}"
        if abs(seen.velocity) > STILL:
            return turns
        known = self.conditions.get(number)
        if self.safe_state == "torque_off" and known is not None and known.torque:
            # It was limp: somebody else on the bus has made it stiff again.
            return "stiff again"
        return ""

    async def go_limp(self, urgency: int) -> None:
        """Switch every torque off by one packet, then see it of each."""

        async def be_limp(servo: Servo) -> None:
            servo.pushing = False
            if await servo.get("torque_enable", urgency=urgency):
                await servo.put("torque_enable", 0, urgency=urgency)
            if known := self.conditions.get(servo.node.number):
                self.conditions[servo.node.number] = replace(known, torque=False)

        servos = self.servos.values()
        await self.send({s: (s.item("torque_enable").address, b"\0") for s in servos}, urgency)
        await self.each(servos, be_limp)
        self._tell_conditions()

    def _places(self, seen: Seen) -> dict[Servo, Present]:
        """Where each member is to stay; one that is silent now, but may hear, where it was a moment ago.

        One that holds something by its force stays by going on.
        """
        now = self.clock.monotonic()
        fresh = {n: value for n, (at, value) in self._seen.items() if now - at <= FRESH}
        places = {self.servos[number]: value for number, value in (fresh | seen).items()}
        return {s: value for s, value in places.items() if not (s.pushing or self._limp(s))}

    def _limp(self, servo: Servo) -> bool:
        """Whether it is known to be limp: a goal would make an AX stiff."""
        known = self.conditions.get(servo.node.number)
        return known is not None and not known.torque

    async def send(self, writes: dict[Servo, tuple[int, bytes]], urgency: int = SAFETY) -> None:
        """Write to several at once, one packet for each address; it reaches those that cannot answer too."""
        for address in sorted({address for address, _ in writes.values()}):
            data = {s.node.number: part for s, (at, part) in writes.items() if at == address}
            protocol = next(iter(writes)).node.protocol
            await self.chain.sync_write(address, data, protocol=protocol, urgency=urgency)

    async def _be_still(self, servo: Servo) -> None:
        """See that a servo has stopped and stays: its goal is where it is, or it cannot turn by itself."""
        now = await servo.condition(urgency=SAFETY)
        if now.torque and now.watchdog != FIRED and not servo.pushing:
            name, place = servo.here(await servo.present(urgency=SAFETY))
            # A goal that is a moment old is as good; one that is far off never reached the servo.
            near = STILL / servo.model.position if name == "goal_position" else 0.0
            if abs(await servo.get(name, urgency=SAFETY) - place) > near:
                await servo.put(name, place, urgency=SAFETY)
        deadline, still = self.clock.monotonic() + STOP, 0
        while still < 2:
            seen = await servo.present(urgency=SAFETY)
            self._seen[servo.node.number] = (self.clock.monotonic(), seen)
            still = still + 1 if abs(seen.velocity) <= STILL else 0
            if not still and self.clock.monotonic() > deadline:
                raise servo.error(f"still turns, at {seen.velocity:.2f} rad/s")
            await asyncio.sleep(LOOK)

    # -- parts ------------------------------------------------------------------------------------------

    async def each(self, servos: Iterable[Servo], work: Callable[[Servo], Awaitable[T]]) -> list[T]:
        """Do something with every servo. Raises DeviceError with what failed, when all had their turn."""
        done, failed = [], []
        for servo in servos:
            try:
                done.append(await work(servo))
            except DeviceError as error:
                failed.append(error)
        if failed:
            silent = all(error.kind == "DeviceTimeoutException" for error in failed)
            raise self.error("; ".join(error.reason for error in failed), timeout=silent)
        return done


def _stay(servo: Servo, place: Present) -> tuple[int, bytes]:
    name, counts = servo.here(place)
    item = servo.item(name)
    return item.address, item.encode(counts)
