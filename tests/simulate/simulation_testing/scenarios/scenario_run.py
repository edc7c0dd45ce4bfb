"""Runs and checks one scenario."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, field

from lfield import exit_status
from lfield.host.recording.recording_target import RecordingTarget
from lfield.mission.bindings import MAX_MEMBERS
from lfield.replication.transfer.transfer_sender import MIN_DOUBT_TIME
from lfield.simulate.computers.event_queue import TooManyEvents
from lfield.simulate.host_fleet import Fleet, FleetOptions, HostRun
from simulation_testing.fault_injection import FaultInjector
from simulation_testing.invariants.breaches import Breach
from simulation_testing.invariants.outcome_recorder import OutcomeRecorder
from simulation_testing.invariants.run_judge import MIN_CALLS, RunJudge
from simulation_testing.scenarios.scenario import RESERVES, Scenario

#: Seconds between two checks of devices and logs.
CHECK_INTERVAL = 0.25
#: The most events of one scenario: ten times those of the longest one.
MAX_EVENTS = 200_000
#: Seconds after the faults within which all coordinators must make progress if they can, in addition to the
#: wait of a call: a Hello without an answer is abandoned after 10 s.
PROGRESS_TIMEOUT = 25.0
#: Seconds until hosts without a link must reach each other on demand, and seconds for which coordinators then
#: hop between them.
SETTLES, ROAMS = 12.0, 4.0


@dataclass(frozen=True, slots=True)
class RunVerdict:
    """The result of a scenario. `seconds` of virtual time; `faults` as they were injected.

    `digest` covers every log line and the number of events; `outcome` only the actions of programs and
    devices. `calls` that began, `restarts` that walkers received, starts that a majority or an operator has
    `recovered`, executed `orders` of an operator, by kind.
    """

    scenario: Scenario
    breaches: tuple[Breach, ...]
    digest: str
    outcome: str
    seconds: float
    faults: tuple[tuple[float, str], ...]
    calls: int
    restarts: int
    recovered: int
    orders: Mapping[str, int] = field(default_factory=dict)
    log: tuple[tuple[float, str, str], ...] = ()


def run_scenario(
    scenario: Scenario, *, keep_log: bool = False, record: RecordingTarget | None = None
) -> RunVerdict:
    """Run a scenario until the first breach, or until all coordinators that can have made progress."""
    # Collections would only cost time: most objects live until `Fleet.close`, which frees closed fleets.
    gc.disable()
    try:
        return _judged_run(scenario, record, keep_log=keep_log)
    finally:
        gc.enable()


def _judged_run(scenario: Scenario, record: RecordingTarget | None, *, keep_log: bool) -> RunVerdict:
    judge, outcome = RunJudge(), OutcomeRecorder()

    def born(name: str, life: HostRun) -> None:
        judge.on_host_start(name, life)
        outcome.on_host_start(name, life)

    fleet = judge.fleet = Fleet(
        scenario.mission,
        scenario.seed,
        on_start=born,
        options=FleetOptions(
            unreachable_after=scenario.unreachable_after,
            lost_after=scenario.lost_after,
            keeps=scenario.journals,
            slowness=scenario.slowness,
            record=record,
        ),
    )
    for disk in fleet.disks.values():
        disk.sync = scenario.sync
    fleet.timeline.max_events = MAX_EVENTS
    storm = FaultInjector(fleet, scenario.forecast, judge.orders)
    # A guard without a host writes to the terminal.
    with contextlib.redirect_stderr(io.StringIO()):
        _happen(fleet, storm, judge, scenario)
        orders = dict(storm.operator.carried_out) if storm.operator else {}
        came_of_it = outcome.digest(fleet, orders, [breach.name for breach in judge.breaches])
        fleet.close()
    digest = hashlib.sha256(f"{fleet.digest} {fleet.timeline.events} {storm.faults}".encode()).hexdigest()
    log = tuple(fleet.log) if keep_log else ()
    recovered, faults = judge.counts["recoveries"], tuple(storm.faults)
    counts = judge.calls, judge.restarts, recovered, orders
    return RunVerdict(scenario, tuple(judge.breaches), digest, came_of_it, fleet.now, faults, *counts, log)


def _happen(fleet: Fleet, storm: FaultInjector, judge: RunJudge, scenario: Scenario) -> None:
    _until(fleet, judge, scenario.seconds)
    if judge.breaches:
        return
    storm.end()
    if scenario.journals:
        fleet.restart_ended()
    judge.on_healed()
    waits = MIN_CALLS * scenario.reserved_wait * (scenario.kind in RESERVES)
    # An operator forgets a coordinator only when its transfer is in doubt.
    doubt_time = max(scenario.unreachable_after, MIN_DOUBT_TIME)
    end = fleet.now + PROGRESS_TIMEOUT + doubt_time + scenario.interval + waits
    while judge.waits_for() and fleet.now < end and not judge.breaches:
        # A suspended host may end regularly, or give the others up, just after the end of the faults.
        fleet.heal_all()
        if storm.operator is not None:
            storm.operator.free_all()
        if scenario.journals:
            fleet.restart_ended(exit_status.UNKNOWN_OUTCOME)
        _until(fleet, judge, fleet.now + 1.0)
    if scenario.hosts > MAX_MEMBERS and not judge.breaches:
        settled = fleet.now + SETTLES + doubt_time
        while fleet.now < settled and not judge.breaches:
            if storm.operator is not None:
                storm.operator.free_all()
            _until(fleet, judge, min(settled, fleet.now + 1.0))
        judge.on_settled()
        _until(fleet, judge, fleet.now + ROAMS)
    if not judge.breaches:
        judge.end()


def _until(fleet: Fleet, judge: RunJudge, when: float) -> None:
    try:
        while fleet.now < when and not judge.breaches:
            fleet.run(min(CHECK_INTERVAL, when - fleet.now))
            judge.check()
    except TooManyEvents as error:
        judge.breaches.add("endless", (), str(error))
