"""Faults of a simulation, drawn before its start as data: a forecast.

A run can be repeated without some of its faults, without a change of the others. Each fault has a duration;
at the end of the forecast all faults are healed, so that progress can be checked.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

from lfield.simulate.computers.simulated_computer import SimulatedProcess
from lfield.simulate.computers.simulated_machine import NetworkPath
from lfield.simulate.host_fleet import Fleet
from lfield.wire.observer_messages import EmergencyStopResult
from simulation_testing.simulated_operator import AnswerChecks, Hold, SimulatedOperator

#: Least and greatest duration of a fault, in seconds, unless stated otherwise.
FAULT_TIMES = (0.05, 8.0)
#: Delay on a slow path, in seconds: messages on two connections arrive in any order.
SLOW = (0.3, 2.0)
#: Share of the faults that are orders of an operator, where there is one.
SLOW_ORDERS = 0.5
#: Seconds for which a process or a computer is suspended.
STOPPED = (0.05, 6.0)
#: Seconds of a split team, long enough for the majority to recover coordinators of the minority.
SPLIT = (4.0, 10.0)
#: Duration of faults of some kinds.
LENGTHS = {"stop": STOPPED, "suspend": STOPPED, "guard_stop": STOPPED, "split": SPLIT}
#: The rate of a drifting clock within the margin of leases, the rate of a broken clock, and the greatest jump
#: of a time of day (s).
DRIFT, RACE, JUMP = (0.99, 1.01), (0.9, 1.1), 1e7
#: The length of a forecast without a stated length, in seconds.
LONG = 300.0
#: The kinds of faults that are orders of an operator, or need one.
ORDERS = ("estop", "pause", "wreck")
#: The share of lost hosts whose coordinators an operator recovers; otherwise they are declared lost.
RECOVERS = 0.7


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault: its true time, its kind, its hosts, its duration, and a number in 0..1."""

    at: float
    kind: str
    one: str
    other: str
    lasts: float
    size: float


@dataclass(frozen=True, slots=True)
class FaultRates:
    """Mean seconds between two faults of each kind in the whole team; 0 for none."""

    cut: float = 0.0
    one_way: float = 0.0
    mute: float = 0.0
    island: float = 0.0
    reset: float = 0.0
    half_open: float = 0.0
    slow: float = 0.0
    kill: float = 0.0
    restart: float = 0.0
    stop: float = 0.0
    power: float = 0.0
    gone: float = 0.0
    suspend: float = 0.0
    drift: float = 0.0
    race: float = 0.0
    clock: float = 0.0
    disk_full: float = 0.0
    disk_fail: float = 0.0
    disk_new: float = 0.0
    guard_kill: float = 0.0
    guard_stop: float = 0.0
    swap: float = 0.0
    split: float = 0.0
    estop: float = 0.0
    pause: float = 0.0
    wreck: float = 0.0
    disk_slow: float = 0.0

    def forecast(self, hosts: Sequence[str], rng: random.Random, seconds: float) -> list[Fault]:
        """The faults of the next `seconds`, in order."""
        faults: list[Fault] = []
        for kind, mean in asdict(self).items():
            own = random.Random(rng.random())
            at = own.expovariate(1.0 / mean) if mean else seconds
            while at < seconds:
                one, other = own.sample(hosts, 2) if len(hosts) > 1 else (hosts[0], hosts[0])
                lasts = own.uniform(*LENGTHS.get(kind, FAULT_TIMES))
                faults.append(Fault(at, kind, one, other, lasts, own.random()))
                at += own.expovariate(1.0 / mean)
        return sorted(faults, key=lambda fault: fault.at)

    def inject(self, fleet: Fleet, rng: random.Random, seconds: float = LONG) -> FaultInjector:
        """Apply the forecast to a team from now on."""
        return FaultInjector(fleet, self.forecast(fleet.mission.team.hosts, rng, seconds), NoChecks())


class FaultInjector:
    """Applies a forecast to one team, until `end`. A fault of a host that is down does nothing."""

    def __init__(self, fleet: Fleet, forecast: Iterable[Fault], judges: AnswerChecks) -> None:
        self.fleet = fleet
        forecast = list(forecast)
        #: The operator for orders, if needed: `judges` receives the answers of hosts.
        self.operator: SimulatedOperator | None = None
        self._judges, self._rng = judges, random.Random(repr(forecast[:1]))
        if any(fault.kind in ORDERS for fault in forecast):
            self.operator = SimulatedOperator(fleet, judges, self._rng)
        #: Every fault that was applied: its time and its description.
        self.faults: list[tuple[float, str]] = []
        self._is_over = False
        kinds: Mapping[str, Callable[[Fault], None]] = {
            "cut": self._cut, "one_way": self._one_way, "mute": self._mute, "island": self._island,
            "reset": self._reset, "half_open": self._half_open,
            "slow": self._slow, "kill": self._kill, "restart": self._restart, "stop": self._stop,
            "power": self._power, "gone": self._gone, "suspend": self._suspend,
            "drift": self._drift, "race": self._race,
            "clock": self._clock, "disk_full": self._disk_full, "disk_fail": self._disk_fail,
            "disk_new": self._disk_new, "disk_slow": self._disk_slow,
            "guard_kill": self._guard_kill, "guard_stop": self._guard_stop, "swap": self._swap,
            "split": self._split, "estop": self._estop, "pause": self._pause, "wreck": self._wreck,
        }  # fmt: skip
        for fault in forecast:
            self._after(fault.at, partial(self._inject, kinds[fault.kind], fault))

    def end(self) -> None:
        """Heal all faults: all paths work, all computers are on, all hosts run."""
        self._is_over = True
        for disk in self.fleet.disks.values():
            disk.full, disk.broken, disk.slow = False, False, 0.0
        self.fleet.heal_all()
        if self.fleet.lost_hosts and self.operator is None:
            self.operator = SimulatedOperator(self.fleet, self._judges, self._rng)
        if self.operator is not None:
            self.operator.free_all()

    def _inject(self, inject: Callable[[Fault], None], fault: Fault) -> None:
        if not self._is_over:
            inject(fault)

    def _after(self, seconds: float, event: Callable[[], None]) -> None:
        self.fleet.timeline.after(seconds, event)

    def _note(self, what: str) -> None:
        self.faults.append((self.fleet.timeline.now, what))

    # --- paths ----------------------------------------------------------------------------------------

    def _cut(self, fault: Fault) -> None:
        self._note(f"cut {fault.one} - {fault.other}")
        self._silence(fault.one, fault.other, fault.lasts)
        self._silence(fault.other, fault.one, fault.lasts * fault.size)

    def _one_way(self, fault: Fault) -> None:
        self._note(f"silence {fault.one} > {fault.other}")
        self._silence(fault.one, fault.other, fault.lasts)

    def _mute(self, fault: Fault) -> None:
        """Drop all packets from a host, but not those to it."""
        self._note(f"{fault.one} is mute")
        for other in self._others(fault.one):
            self._silence(fault.one, other, fault.lasts)

    def _island(self, fault: Fault) -> None:
        self._note(f"{fault.one} is cut off from all")
        for other in self._others(fault.one):
            self._silence(fault.one, other, fault.lasts)
            self._silence(other, fault.one, fault.lasts)

    def _swap(self, fault: Fault) -> None:
        """Cut one host off from all, then another; in between, kill the hosts that were in contact with both.

        So the two have no contact, and information about each other comes only from disks.
        """
        self._island(fault)
        swapped = replace(fault, one=fault.other, other=fault.one)
        self._after(fault.lasts, partial(self._inject, self._swapped, swapped))

    def _swapped(self, fault: Fault) -> None:
        self._island(fault)
        for name in self._others(fault.one):
            if name != fault.other:
                self._kill(replace(fault, one=name, lasts=fault.size))

    def _split(self, fault: Fault) -> None:
        """Split the team into two groups, of at least two hosts if possible."""
        others = sorted(set(self._others(fault.one)) - {fault.other})
        count = 2 + int(fault.size * max(1, len(others) - 2))
        near = [fault.one, *random.Random(fault.size).sample(others, min(count - 1, len(others)))]
        far = [name for name in self._others(fault.one) if name not in near]
        self._note(f"{', '.join(sorted(near))} are cut off from {', '.join(far)}")
        for one in near:
            for other in far:
                self._silence(one, other, fault.lasts)
                self._silence(other, one, fault.lasts)

    def _others(self, name: str) -> list[str]:
        return [other for other in self.fleet.mission.team.hosts if other != name]

    def _silence(self, near: str, far: str, lasts: float) -> None:
        self.fleet.network.silence(near, far)
        self._after(lasts, partial(self.fleet.network.heal, near, far))

    def _reset(self, fault: Fault) -> None:
        self._note(f"reset {fault.one} - {fault.other}")
        self.fleet.network.reset(fault.one, fault.other)

    def _half_open(self, fault: Fault) -> None:
        self._note(f"half open {fault.one} - {fault.other}")
        self.fleet.network.half_open(fault.one, fault.other)
        self._silence(fault.one, fault.other, fault.lasts)

    def _slow(self, fault: Fault) -> None:
        pressed = self.operator is not None and bool(self.operator.presses)
        near = "operator" if pressed and fault.size < SLOW_ORDERS else fault.one
        self._note(f"slow {near} > {fault.other}")
        self.fleet.network.paths.slow[near, fault.other] = SLOW
        self._after(fault.lasts, partial(self._quick, (near, fault.other)))

    def _quick(self, way: NetworkPath) -> None:
        self.fleet.network.paths.slow.pop(way, None)

    # --- computers and processes ----------------------------------------------------------------------

    def _runs(self, fault: Fault, what: str) -> bool:
        if runs := fault.one in self.fleet.runs:
            self._note(f"{what} {fault.one}")
        return runs

    def _kill(self, fault: Fault) -> None:
        if self._runs(fault, "kill"):
            self.fleet.crash(fault.one)
            self._after(fault.lasts, partial(self._start, fault.one))

    def _restart(self, fault: Fault) -> None:
        if self._runs(fault, "restart"):
            self.fleet.stop(fault.one)
            self._after(fault.lasts, partial(self._start, fault.one))

    def _power(self, fault: Fault) -> None:
        if self._runs(fault, "power"):
            self.fleet.power_off(fault.one)
            self._after(fault.lasts, partial(self._start, fault.one))

    def _gone(self, fault: Fault) -> None:
        """Lose a host permanently, if the others can continue without it."""
        members, lost = self.fleet.mission.recovery.members, self.fleet.lost_hosts
        if len(lost) < (len(members) - 1) // 2 and fault.one not in lost:
            self._note(f"{fault.one} is permanently lost")
            self.fleet.lose(fault.one)

    def _disk_new(self, fault: Fault) -> None:
        if self._runs(fault, "new disk for"):
            self.fleet.power_off(fault.one)
            self.fleet.lose_disk(fault.one)
            self._after(fault.lasts, partial(self._start, fault.one))

    def _start(self, name: str) -> None:
        """Restart a host, after its end if it is still ending."""
        life = self.fleet.runs.get(name)
        if life is not None and life.shutdown_signals.first_requested.is_set():
            self._after(0.5, partial(self._start, name))
        elif life is None and name not in self.fleet.left:
            self.fleet.boot(name)

    def _stop(self, fault: Fault) -> None:
        if self._runs(fault, "stop"):
            self._freeze(self.fleet.runs[fault.one].process, fault)

    def _freeze(self, process: SimulatedProcess, fault: Fault) -> None:
        process.loop.freeze()
        self._after(fault.lasts, process.loop.thaw)

    def _suspend(self, fault: Fault) -> None:
        """Suspend the monotonic clock of a host, not its time of day; the host receives and sends nothing."""
        computer, clock = self.fleet.computers[fault.one], self.fleet.machines[fault.one].clock
        if clock.suspended or not self._runs(fault, "suspend"):
            return
        for process in list(computer.processes):
            self._freeze(process, fault)
        for other in self._others(fault.one):
            self._silence(fault.one, other, fault.lasts)
            self._silence(other, fault.one, fault.lasts)
        clock.suspend(fault.lasts)

    def _drift(self, fault: Fault) -> None:
        self._runs_at(fault, DRIFT)

    def _race(self, fault: Fault) -> None:
        self._runs_at(fault, RACE)

    def _runs_at(self, fault: Fault, rates: tuple[float, float]) -> None:
        rate = rates[0] + (rates[1] - rates[0]) * fault.size
        self._note(f"clock of {fault.one} at {rate:.3f}")
        usual = self.fleet.machines[fault.one].rate
        self._pace(fault.one, rate)
        self._after(fault.lasts, partial(self._pace, fault.one, usual))

    def _pace(self, name: str, rate: float) -> None:
        self.fleet.machines[name].clock.run_at(rate)
        for process in list(self.fleet.computers[name].processes):
            process.loop.enter(_nothing)

    def _clock(self, fault: Fault) -> None:
        jump = JUMP * (2.0 * fault.size - 1.0)
        self._note(f"time of day of {fault.one} jumps {jump:+.0f} s")
        self.fleet.machines[fault.one].clock.ahead += jump

    def _disk_full(self, fault: Fault) -> None:
        self._note(f"disk full on {fault.one}")
        disk = self.fleet.disks[fault.one]
        disk.full = True
        self._after(fault.lasts, partial(setattr, disk, "full", False))

    def _disk_fail(self, fault: Fault) -> None:
        self._note(f"disk fails on {fault.one}")
        disk = self.fleet.disks[fault.one]
        disk.broken = True
        self._after(fault.lasts, partial(setattr, disk, "broken", False))

    def _disk_slow(self, fault: Fault) -> None:
        self._note(f"disk of {fault.one} is slow")
        disk = self.fleet.disks[fault.one]
        disk.slow = fault.lasts
        self._after(fault.lasts, partial(setattr, disk, "slow", 0.0))

    # --- orders of an operator ------------------------------------------------------------------------

    def _estop(self, fault: Fault) -> None:
        if self.operator is not None:
            self._note("emergency stop")
            self.operator.press("stop", fault.lasts)

    def _pause(self, fault: Fault) -> None:
        if self.operator is not None:
            self._note("pause")
            self.operator.press("pause", fault.lasts)

    def _wreck(self, fault: Fault) -> None:
        """Lose a host permanently; no majority may continue without it, so an operator must act."""
        if self.operator is None or self.fleet.lost_hosts or self.fleet.mission.fenced:
            return
        self._note(f"{fault.one} is wrecked")
        self.fleet.lose(fault.one)
        self._after(fault.lasts, partial(self.operator.lose, recovers=fault.size < RECOVERS))

    # --- guards ---------------------------------------------------------------------------------------

    def _guard_kill(self, fault: Fault) -> None:
        if guard := self._guard(fault):
            self._note(f"kill a guard of {fault.one}")
            guard.die(-9)

    def _guard_stop(self, fault: Fault) -> None:
        if guard := self._guard(fault):
            self._note(f"stop a guard of {fault.one}")
            self._freeze(guard, fault)

    def _guard(self, fault: Fault) -> SimulatedProcess | None:
        hosts = [life.process for life in self.fleet.runs.values()]
        guards = [p for p in self.fleet.computers[fault.one].processes if p not in hosts]
        return guards[int(fault.size * len(guards))] if guards else None


class NoChecks:
    """The answers of hosts to an operator are not checked."""

    def on_confirmed(self, hold: Hold, host: str, answer: EmergencyStopResult) -> None:
        """See `AnswerChecks`."""

    def on_lifting(self, hold: Hold) -> None:
        """See `AnswerChecks`."""

    def on_given_up(self, agent: str, starts: Mapping[str, int]) -> None:
        """See `AnswerChecks`."""

    def on_recovery_by_operator(self) -> None:
        """See `AnswerChecks`."""


def _nothing() -> None:
    """An event that makes a loop read its clock."""
