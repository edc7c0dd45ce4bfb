"""All devices of one host: a guard process per bus, and fakes where the mission is simulated."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from lfield import loop
from lfield.capability.directory.news import Trouble
from lfield.clock import Clock
from lfield.devices.calls import Answered
from lfield.devices.fakes import Fake, on_running_fakes
from lfield.devices.held import Tell
from lfield.devices.keeper import Guard
from lfield.devices.lateness import Lateness, Limit
from lfield.driver.binding import DeviceBinding, by_bus
from lfield.driver.contract import RELEASE
from lfield.driver.known import Drivers
from lfield.errors import DeviceError, DevicesError
from lfield.guard.core import SILENCE
from lfield.manifest import DeviceManifest, DeviceValue, Instruction, Observation
from lfield.vm.contract import Reading
from lfield.vm.world import PENDING, Pending

#: Seconds for every device to confirm its safe state after an emergency stop.
STOPS_WITHIN = 5.0


class Guards:
    """The devices of some agents, by `drivers` that are known. `note` takes a line for the log.

    `silence` is how long this host may be silent, in seconds, before its devices go safe. Before each sign of
    life `turned` lets the host turn, and says whether it could: a host that cannot gives none.
    """

    def __init__(
        self,
        drivers: Drivers,
        clock: Clock,
        note: Callable[[str], None],
        *,
        silence: float = SILENCE,
        turned: Callable[[], bool] = lambda: True,
    ) -> None:
        self._drivers, self.clock, self._note = drivers, clock, note
        #: How late the beats for the guards are.
        self.lateness = Lateness(Limit(silence, loop.may_be_prompt()))
        self._turned = turned
        #: Called with what becomes of devices in their safe states, for whoever watches the host.
        self.tell: Tell = lambda event: None
        #: Called with each device that its driver has locked out until it is inspected, and why.
        self.on_lock_out: Callable[[str, str], None] = lambda device, reason: None
        self._guards: list[Guard] = []
        #: Why no program may release a device, '' while all may; also of those that are yet to be opened.
        self._barred = ""
        #: One for each emergency stop that is under way: several may be pressed at a time.
        self._stopping: list[asyncio.Event] = []
        self._fakes: list[Fake] = []
        #: Those of the problems of opening that `lfield setup` would solve.
        self._not_set_up: list[str] = []
        #: What `close` has found, also when the devices could not all be opened.
        self._unsafe: dict[str, str] = {}
        self._by_device: dict[str, tuple[Guard, DeviceManifest]] = {}

    async def open(self, devices: Sequence[DeviceBinding]) -> None:
        """Open all devices at once. Raises DevicesError with all problems; then none is left open."""
        problems: list[str] = []
        try:
            await self._open(devices, problems)
        except BaseException:
            await self.close()
            raise
        if problems:
            await self.close()
            raise DevicesError(problems, self._not_set_up)

    async def _open(self, devices: Sequence[DeviceBinding], problems: list[str]) -> None:
        problems += _shared_ports(devices)
        placed = await on_running_fakes(devices, self._fakes, problems) if not problems else []
        if problems:
            return
        for bus in by_bus(placed).values():
            driver = self._drivers.by_driver[bus[0].driver]
            guard = Guard(driver, bus, self.clock, self._note, self.lateness, self._turned)
            guard.held.barred, guard.held.tell = self._barred, self.tell
            guard.held.on_lock_out = self.on_lock_out
            self._guards.append(guard)
            self._by_device.update(
                {device.name: (guard, driver.manifests[device.type].device) for device in bus}
            )
        for answer in await asyncio.gather(*(g.open() for g in self._guards), return_exceptions=True):
            if isinstance(answer, DevicesError):
                problems.extend(answer.problems)
                self._not_set_up.extend(answer.not_set_up)
            elif isinstance(answer, BaseException):
                raise answer

    def query(self, agent: str, field: str, instruction: str) -> DeviceValue | Pending:
        """The value of a query, PENDING for what the device itself must do (`call`).

        Raises DeviceError when there is no such device or instruction, or no fresh value.
        """
        guard, declared = self._declared(agent, field, instruction)
        if declared.is_query:
            return guard.snapshots.query(f"{agent}.{field}", instruction)
        return PENDING

    def call(
        self,
        agent: str,
        field: str,
        instruction: str,
        arguments: Sequence[Any],
        answered: Answered,
        until: float = math.inf,
        thread: int = 0,
    ) -> None:
        """Have an instruction carried out that is no query; `answered` is told once, from the loop.

        What acts begins before `until`, in seconds of the host's clock, and within the device's `ttl`; or not
        at all. `thread` of the agent is who waits for it, for `cancel`; a thread waits for one at a time.
        Raises DeviceError when it cannot even be tried.
        """
        guard, declared = self._declared(agent, field, instruction)
        guard.call(f"{agent}.{field}", declared, arguments, answered, until, thread)

    def cancel(self, agent: str, thread: int) -> bool:
        """Have what a thread of an agent waits for be given up; whether it is.

        True: its answer comes as that of every call, once. It is a DeviceError of kind CancelledException
        when the device has done what its manifest says of a cancel, or could not; the result, when that was
        on its way; or what became of it when its guard dies. False: nothing is under way, or it may not be
        cancelled and goes on to its end. To cancel twice is to cancel once.
        """
        return any(guard.cancel(agent, thread) for guard in self._guards)

    def may_be_cancelled(self, agent: str, field: str, instruction: str) -> bool:
        """Whether a call of this instruction can be given up; not that of a device that is not open here."""
        found = self._by_device.get(f"{agent}.{field}")
        declared = found[1].instruction(instruction) if found else None
        return declared is not None and declared.may_be_cancelled

    def _declared(self, agent: str, field: str, instruction: str) -> tuple[Guard, Instruction]:
        found = self._by_device.get(f"{agent}.{field}")
        if found is None:
            raise DeviceError(field, "is not open on this host")
        guard, manifest = found
        declared = manifest.instruction(instruction)
        if declared is None:
            raise DeviceError(field, f"has no instruction '{instruction}'")
        return guard, declared

    def reading(self, agent: str, field: str, quantity: str) -> Reading | None:
        """The reading of a telemetry quantity, None for what is no plain quantity."""
        return self.guard_of(f"{agent}.{field}").snapshots.reading(f"{agent}.{field}", quantity)

    def last(self, device: str, quantity: str) -> Observation | None:
        """The last value of a telemetry quantity, however old; None for none yet."""
        found = self._by_device.get(device)
        return found[0].snapshots.last(device, quantity) if found else None

    def trouble(self, device: str) -> Trouble | None:
        """Why a device cannot be called now, by its name; None when it can."""
        found = self._by_device.get(device)
        return found[0].trouble(device) if found else Trouble(f"{device}: not open on this host")

    def make_safe(self, device: str, reason: str, state: str) -> None:
        """Bring a device into a safe state of its manifest, from which the program may release it.

        Nothing happens when the devices are closed already.
        """
        if found := self._by_device.get(device):
            found[0].make_safe(device, reason, state)

    def guard_of(self, device: str) -> Guard:
        """The guard of a device by its name."""
        return self._by_device[device][0]

    def bar(self, reason: str) -> None:
        """Every device into its safe state, from which no program releases it before `lift_stop`.

        Those that are not open yet are barred from the beginning.
        """
        self._barred = reason
        for guard in self._guards:
            guard.bar(reason)

    async def emergency_stop(self, reason: str) -> dict[str, str]:
        """The same, and what `confirmed` finds."""
        self.bar(reason)
        return await self.confirmed()

    async def rest(self, reason: str) -> dict[str, str]:
        """The same, and whoever calls `let_go` with that reason may have them back; no program is barred."""
        for guard in self._guards:
            for name in guard.movable:
                guard.make_safe(name, reason)
        return await self.confirmed()

    async def let_go(self, reason: str) -> dict[str, str]:
        """Release the devices that are held for that reason; for each that moves why it stays held, or ''."""
        table: dict[str, str] = {}
        for guard in self._guards:
            for name in guard.movable:
                held = guard.held.latched.get(name, "")
                barred = guard.held.barred or guard.held.locked_out.get(name, "")
                table[name] = barred or (held if held != reason else "")
                if held and not table[name]:
                    table[name] = await self._release(name)
        return table

    async def _release(self, name: str) -> str:
        """Why a device could not be released, '' when it is."""
        answered: asyncio.Future[DeviceValue | DeviceError] = asyncio.get_running_loop().create_future()
        agent, _, field = name.rpartition(".")

        def tell(value: DeviceValue | DeviceError) -> None:
            if not answered.done():
                answered.set_result(value)

        try:
            self.call(agent, field, RELEASE.name, (), tell)
            async with asyncio.timeout(STOPS_WITHIN):
                value = await answered
        except (DeviceError, TimeoutError) as error:
            return str(error) or "it does not answer"
        return str(value) if isinstance(value, DeviceError) else ""

    async def confirmed(self) -> dict[str, str]:
        """'' for every device that has confirmed its safe state within STOPS_WITHIN, else why it has not."""
        changed = asyncio.Event()
        self._stopping.append(changed)
        for guard in self._guards:
            guard.held.on_change = self._latched
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(STOPS_WITHIN):
                while any(not guard.held.confirmed.issuperset(guard.movable) for guard in self._guards):
                    changed.clear()
                    await changed.wait()
        self._stopping.remove(changed)
        return {name: _unconfirmed(guard, name) for guard in self._guards for name in guard.movable}

    def _latched(self) -> None:
        for changed in self._stopping:
            changed.set()

    def lift_stop(self) -> dict[str, str]:
        """The program may release its devices again; the same table, all ''."""
        self._barred = ""
        for guard in self._guards:
            guard.allow()
        return {name: "" for guard in self._guards for name in guard.movable}

    @property
    def latched(self) -> Mapping[str, str]:
        """Why devices are held in their safe states, by device name."""
        return {name: reason for guard in self._guards for name, reason in guard.held.latched.items()}

    @property
    def moving(self) -> Mapping[str, str]:
        """What latched devices still do in their safe states, by device name; '' once one is at rest."""
        return {name: words for guard in self._guards for name, words in guard.held.moving.items()}

    @property
    def heard(self) -> Mapping[str, float]:
        """When each device was last heard, on the monotonic clock; nothing for one that never was."""
        return {name: when for guard in self._guards for name, when in guard.snapshots.heard.items()}

    @property
    def telemetry(self) -> Mapping[str, Mapping[str, DeviceValue]]:
        """The last values known, by device and quantity."""
        return {name: values for guard in self._guards for name, values in guard.snapshots.telemetry.items()}

    async def close(self) -> dict[str, str]:
        """Make every device safe, end the guards when all are at rest, then the fakes.

        Returns the devices that have not been seen there, by name: each with what was last known of it. How
        they were at the end can still be asked.
        Bounded by their `rest_within`; `hurry` makes it short.
        """
        ends = await asyncio.gather(*(self._close(guard) for guard in self._guards))
        await asyncio.gather(*(fake.stop() for fake in self._fakes))
        self._fakes, self._by_device = [], {}
        for end in ends:
            self._unsafe |= end
        return self._unsafe

    async def _close(self, guard: Guard) -> dict[str, str]:
        unsafe = await guard.close()
        guard.held.moving.update({name: "" for name in guard.movable if name not in unsafe})
        return {name: f"{why}; {guard.snapshots.in_words(name)}" for name, why in unsafe.items()}

    def hurry(self) -> None:
        """Wait for no device any longer; `close` then ends, and tells who is not at rest."""
        for guard in self._guards:
            guard.hurry()


def _unconfirmed(guard: Guard, name: str) -> str:
    """Why an emergency stop does not know a device safe; '' when it does."""
    if name not in guard.held.confirmed:
        return f"its safe state was not confirmed in {STOPS_WITHIN:g} s"
    if guard.snapshots.lost_since(name) is not None:
        return f"it was in its safe state before, and is not heard any more; {guard.snapshots.in_words(name)}"
    return ""


def _shared_ports(devices: Sequence[DeviceBinding]) -> list[str]:
    """One port has one driver; two of them would take each other's bytes."""
    first: dict[str, DeviceBinding] = {}
    return [
        f"{rival.name} and {device.name} are both at {device.endpoint}, one by the driver '{rival.driver}', "
        f"one by '{device.driver}': one port can have one driver"
        for device in devices
        if (rival := first.setdefault(device.endpoint, device)).driver != device.driver
    ]
