"""Scenarios with pushes: a team, desks with their steps, and faults, all drawn from one seed and checked."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import io
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

from lfield.service.service import CLOSE_AFTER, RESOLVE_EVERY
from lfield.service.service_process import PEER_TIMEOUT
from lfield.simulate.computers.event_queue import TooManyEvents
from simulation_testing.invariants.breaches import Breach
from simulation_testing.services.push_desk import DeskAction, DeskStep, SimulatedDesk
from simulation_testing.services.service_fleet import VERSIONS, ServiceFleet, bundle_version

#: Seconds within which all ballots are decided after the last fault: the time until a ballot is closed, and
#: rounds of queries of which each waits for hosts that do not answer.
SETTLES = CLOSE_AFTER + 4 * (RESOLVE_EVERY + PEER_TIMEOUT)
#: Seconds for an undisturbed push of a desk, and attempts: a vote may get lost within a robot.
LAST_PUSH, LAST_PUSHES = 60.0, 4
#: The most events of one scenario.
MAX_EVENTS = 400_000
#: Seconds of short and long faults (some until ballots are closed), of a slow path and of a slow disk.
SHORT, LONG, SLOW_WAY, SLOW_DISK = (0.5, 12.0), (12.0, 60.0), (0.3, 3.0), (0.05, 1.0)
#: The most saves until a planned kill.
SAVES = 4
#: The kinds of faults, with the mean seconds between two faults of a kind.
KINDS: Mapping[str, float] = {
    "cut": 10.0,
    "one_way": 15.0,
    "island": 20.0,
    "island_at_vote": 12.0,
    "desk_cut": 20.0,
    "reset": 10.0,
    "slow": 20.0,
    "kill_service": 15.0,
    "kill_before_save": 15.0,
    "kill_after_save": 15.0,
    "kill_both": 15.0,
    "kill_host": 20.0,
    "kill_desk": 25.0,
    "power": 40.0,
    "freeze": 25.0,
    "disk_full": 30.0,
    "disk_slow": 30.0,
    "person_pauses": 25.0,
    "person_resumes_at_vote": 12.0,
}
_ACTIONS: tuple[tuple[DeskAction, int], ...] = (
    ("push", 6),
    ("push without", 4),
    ("start", 4),
    ("stop", 2),
    ("discard", 3),
)


@dataclass(frozen=True, slots=True)
class PushFault:
    """One fault: its time, its kind, its robots, its duration in seconds, and a number from 0 to 1."""

    at: float
    kind: str
    one: str
    other: str
    lasts: float
    size: float


@dataclass(frozen=True, slots=True)
class PushScenario:
    """A scenario. `steps` are those of each desk; `faults` happen within `seconds`."""

    seed: int
    robots: int
    seconds: float
    steps: tuple[tuple[DeskStep, ...], ...]
    faults: tuple[PushFault, ...]


@dataclass(frozen=True, slots=True)
class PushVerdict:
    """The result of a scenario: breaches, a digest of the events, and counts."""

    scenario: PushScenario
    breaches: tuple[Breach, ...]
    digest: str
    seconds: float
    counts: Mapping[str, int]
    log: tuple[tuple[float, str, str], ...] = ()


def draw_push_scenario(seed: int) -> PushScenario:
    """The scenario of a seed."""
    rng = random.Random(f"pushes {seed}")
    robots, seconds = rng.choice((2, 2, 3, 3, 4)), rng.uniform(40.0, 120.0)
    steps = tuple(_desk_steps(rng, seconds, robots) for _ in range(rng.choice((1, 2, 2, 3))))
    names = [f"h{number}" for number in range(robots)]
    # Only some kinds, and rare ones in some scenarios: otherwise every push is disturbed.
    calm = rng.choice((1.0, 2.0, 5.0))
    faults: list[PushFault] = []
    for kind, mean in KINDS.items():
        if rng.random() < 0.5:
            continue
        at = rng.expovariate(1.0 / (mean * calm))
        while at < seconds:
            one, other = rng.sample(names, 2)
            faults.append(
                PushFault(at, kind, one, other, rng.uniform(*rng.choice((SHORT, SHORT, LONG))), rng.random())
            )
            at += rng.expovariate(1.0 / (mean * calm))
    faults.sort(key=lambda fault: fault.at)
    return PushScenario(seed, robots, seconds, steps, tuple(faults))


def _desk_steps(rng: random.Random, seconds: float, robots: int) -> tuple[DeskStep, ...]:
    steps = [DeskStep(rng.uniform(0.0, 2.0), "push", rng.randrange(VERSIONS))]
    actions, weights = zip(*_ACTIONS, strict=True)
    at = rng.uniform(4.0, 12.0)
    while at < seconds:
        action = rng.choices(actions, weights)[0]
        dies = rng.randint(1, 2 * robots) if rng.random() < 0.25 else 0
        steps.append(DeskStep(at, action, rng.randrange(VERSIONS), dies))
        at += rng.choice((rng.uniform(0.1, 2.0), rng.uniform(3.0, 20.0)))
    return tuple(steps)


def run_push_scenario(scenario: PushScenario, *, keep_log: bool = False) -> PushVerdict:
    """Run a scenario until the first breach, or until all is decided and one more push has succeeded."""
    # Collections would only cost time: nearly all objects live until `close`, which frees closed fleets.
    gc.disable()
    try:
        return _judged_run(scenario, keep_log=keep_log)
    finally:
        gc.enable()


def _judged_run(scenario: PushScenario, *, keep_log: bool) -> PushVerdict:
    fleet = ServiceFleet(scenario.robots, scenario.seed)
    fleet.timeline.max_events = MAX_EVENTS
    with contextlib.redirect_stderr(io.StringIO()):
        _happen(fleet, scenario)
        seconds = fleet.now
        fleet.close()
    digest = hashlib.sha256(f"{fleet.digest} {fleet.timeline.events}".encode()).hexdigest()
    log = tuple(fleet.log) if keep_log else ()
    counts = {**fleet.judge.counts, "faults": len(scenario.faults)}
    return PushVerdict(scenario, tuple(fleet.judge.breaches), digest, seconds, counts, log)


def _happen(fleet: ServiceFleet, scenario: PushScenario) -> None:
    judge, rng = fleet.judge, random.Random(f"desks {scenario.seed}")
    desks = [
        SimulatedDesk(fleet, f"desk{number}", steps, random.Random(rng.random()))
        for number, steps in enumerate(scenario.steps)
    ]
    faults = PushFaults(fleet, scenario, desks)
    last = SimulatedDesk(fleet, "desk", (), random.Random(rng.random()))
    try:
        fleet.run(scenario.seconds)
        faults.end()
        end = fleet.now + SETTLES
        fleet.run(2 * RESOLVE_EVERY)
        while judge.undecided and fleet.now < end and not judge.breaches:
            fleet.run(1.0)
        if not judge.breaches:
            judge.check_settled({robot: robot in fleet.services for robot in fleet.robots})
        _push_undisturbed(fleet, last)
    except TooManyEvents as error:
        judge.breaches.add("too many events", (), str(error))


def _push_undisturbed(fleet: ServiceFleet, desk: SimulatedDesk) -> None:
    """After a stop with discard a push succeeds, and all robots run its bundle."""
    judge, version = fleet.judge, VERSIONS
    desk.perform(DeskStep(0.0, "discard"))
    fleet.run(LAST_PUSH)
    for _ in range(LAST_PUSHES):
        if judge.breaches or any(result.outcome == "activated" for result in desk.results):
            break
        desk.perform(DeskStep(0.0, "push", version))
        fleet.run(LAST_PUSH)
    if judge.breaches:
        return
    expected = bundle_version(len(fleet.robots), version)
    for robot in fleet.robots:
        record = judge.records.get(robot)
        if record is None or fleet.disks[robot].bundles.get(record.activation.active) != expected:
            judge.breaches.add("push failed", (robot,), "nothing disturbs it, and its bundle is not active")
    judge.check_settled({robot: robot in fleet.services for robot in fleet.robots})


class PushFaults:
    """The faults of a scenario, until `end`. A fault of a robot that is off does nothing."""

    def __init__(self, fleet: ServiceFleet, scenario: PushScenario, desks: list[SimulatedDesk]) -> None:
        self._fleet, self._desks, self._is_over = fleet, desks, False
        for fault in scenario.faults:
            fleet.timeline.at(fault.at, partial(self._strike, fault))

    def end(self) -> None:
        """Heal everything, and end the desks."""
        self._is_over = True
        fleet = self._fleet
        fleet.judge.at_vote.clear()
        fleet.network.heal_all()
        for desk in self._desks:
            desk.kill()
        for robot, disk in fleet.disks.items():
            self._order_pause(robot, on=False)
            disk.plan_kill("")
            disk.is_full, disk.slow, disk.kills_host = False, 0.0, False
            fleet.power_on(robot)
            for process in list(fleet.computers[robot].processes):
                process.loop.thaw()

    def _strike(self, fault: PushFault) -> None:
        if self._is_over:
            return
        self._fleet.note("weather", f"{fault.kind} {fault.one} {fault.other} {fault.lasts:.1f} s")
        heal = getattr(self, f"_{fault.kind}")(fault)
        if heal is not None:
            self._fleet.timeline.after(fault.lasts, partial(self._heal, heal))

    def _heal(self, heal: Callable[[], None]) -> None:
        if not self._is_over:
            heal()

    # --- the network ----------------------------------------------------------------------------------

    def _silence(self, ways: list[tuple[str, str]]) -> Callable[[], None]:
        def heal() -> None:
            for way in ways:
                self._fleet.network.heal(*way)

        for way in ways:
            self._fleet.network.silence(*way)
        return heal

    def _cut(self, fault: PushFault) -> Callable[[], None]:
        self._fleet.network.reset(fault.one, fault.other)
        return self._silence([(fault.one, fault.other), (fault.other, fault.one)])

    def _one_way(self, fault: PushFault) -> Callable[[], None]:
        return self._silence([(fault.one, fault.other)])

    def _island(self, fault: PushFault) -> Callable[[], None]:
        others = [*self._fleet.robots, *(desk.name for desk in self._desks)]
        others.remove(fault.one)
        return self._silence([way for other in others for way in ((fault.one, other), (other, fault.one))])

    def _island_at_vote(self, fault: PushFault) -> None:
        """The answer with the next vote of a robot is lost, and it is unreachable for a while."""

        def cut() -> None:
            if self._is_over:
                return
            self._reset(fault)
            self._fleet.timeline.after(fault.lasts, partial(self._heal, self._island(fault)))

        self._fleet.judge.at_vote[fault.one] = lambda: self._fleet.later(cut)

    def _desk_cut(self, fault: PushFault) -> Callable[[], None]:
        desk = self._desk(fault)
        return self._silence([(desk.name, fault.one), (fault.one, desk.name)])

    def _reset(self, fault: PushFault) -> None:
        for other in (*self._fleet.robots, *(desk.name for desk in self._desks)):
            if other != fault.one:
                self._fleet.network.reset(fault.one, other)

    def _slow(self, fault: PushFault) -> Callable[[], None]:
        desk, slow = self._desk(fault), self._fleet.network.paths.slow
        ways = [(fault.one, fault.other), (desk.name, fault.one), (fault.one, desk.name)]
        slow |= dict.fromkeys(ways, SLOW_WAY)

        def heal() -> None:
            for way in ways:
                slow.pop(way, None)

        return heal

    # --- processes ------------------------------------------------------------------------------------

    def _desk(self, fault: PushFault) -> SimulatedDesk:
        return self._desks[int(fault.size * len(self._desks))]

    def _kill_service(self, fault: PushFault) -> None:
        self._fleet.kill_service(fault.one)

    def _kill_before_save(self, fault: PushFault) -> None:
        self._fleet.disks[fault.one].plan_kill("before", int(fault.size * SAVES))

    def _kill_after_save(self, fault: PushFault) -> None:
        self._fleet.disks[fault.one].plan_kill("after", int(fault.size * SAVES))

    def _kill_both(self, fault: PushFault) -> None:
        """The service and the host of a robot are killed after the next save, or the next after a vote."""
        disk = self._fleet.disks[fault.one]

        def arm() -> None:
            if not self._is_over:
                disk.plan_kill("after")
                disk.kills_host = True

        if fault.size < 0.3:
            arm()
        else:
            self._fleet.judge.at_vote[fault.one] = lambda: self._fleet.later(arm)

    def _kill_host(self, fault: PushFault) -> None:
        self._fleet.kill_host(fault.one)

    def _kill_desk(self, fault: PushFault) -> None:
        self._desk(fault).kill()

    def _power(self, fault: PushFault) -> Callable[[], None]:
        self._fleet.power_off(fault.one)
        return partial(self._fleet.power_on, fault.one)

    def _freeze(self, fault: PushFault) -> Callable[[], None] | None:
        if (process := self._fleet.services.get(fault.one)) is None:
            return None
        process.loop.freeze()
        return process.loop.thaw

    # --- operators ------------------------------------------------------------------------------------

    def _person_pauses(self, fault: PushFault) -> Callable[[], None]:
        """An operator pauses the mission of a robot for a while."""
        self._order_pause(fault.one, on=True)
        return partial(self._order_pause, fault.one, on=False)

    def _person_resumes_at_vote(self, fault: PushFault) -> None:
        """An operator resumes the mission of a robot that has just voted."""

        def resume() -> None:
            if not self._is_over:
                self._order_pause(fault.one, on=False)

        self._fleet.judge.at_vote[fault.one] = lambda: self._fleet.later(resume)

    def _order_pause(self, robot: str, *, on: bool) -> None:
        judge = self._fleet.judge
        if judge.missions[robot].order_pause(on=on):
            (judge.paused.add if on else judge.paused.discard)(robot)

    # --- disks ----------------------------------------------------------------------------------------

    def _disk_full(self, fault: PushFault) -> Callable[[], None]:
        disk = self._fleet.disks[fault.one]
        disk.is_full = True
        return partial(setattr, disk, "is_full", False)

    def _disk_slow(self, fault: PushFault) -> Callable[[], None]:
        disk = self._fleet.disks[fault.one]
        disk.slow = SLOW_DISK[0] + fault.size * (SLOW_DISK[1] - SLOW_DISK[0])
        return partial(setattr, disk, "slow", 0.0)


def smaller_scenarios(scenario: PushScenario) -> list[PushScenario]:
    """Scenarios without one fault or one step."""
    found = [
        replace(scenario, faults=scenario.faults[:n] + scenario.faults[n + 1 :])
        for n in range(len(scenario.faults))
    ]
    for desk, steps in enumerate(scenario.steps):
        for n in range(len(steps)):
            fewer = steps[:n] + steps[n + 1 :]
            found.append(
                replace(scenario, steps=(*scenario.steps[:desk], fewer, *scenario.steps[desk + 1 :]))
            )
    return found
