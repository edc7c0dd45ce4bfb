"""One story, told and judged."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, field

from lfield import exits
from lfield.mission.bindings import MOST_MEMBERS
from lfield.simulate.computers.timeline import Endless
from lfield.simulate.fleet import Fleet, Life
from lfield.simulate.judging.breaches import Breach
from lfield.simulate.judging.judge import ENOUGH, Judge
from lfield.simulate.judging.outcome import OutcomeRecorder
from lfield.simulate.stories.story import RESERVES, Story
from lfield.simulate.weather import Storm

#: Seconds between two looks at devices and logs.
LOOK = 0.25
#: So much may happen in one story: ten times of what happens in the longest that were ever told.
MOST_EVENTS = 200_000
#: Seconds after the weather in which whoever may go on must have done so, beside those that a call waits: a
#: greeting that nobody answered is given up after 10 s.
PATIENCE = 25.0
#: Seconds until hosts without a link must reach each other when they want to, and for how long coordinators
#: go from one to the other then.
SETTLES, ROAMS = 12.0, 4.0


@dataclass(frozen=True, slots=True)
class Verdict:
    """What came of a story. `seconds` of virtual time; `faults` as they struck.

    `digest` covers every log line and the number of events; `outcome` what programs and devices did only.
    `calls` that began, `restarts` that a walker was told of, starts that a majority or a person has
    `recovered`, `orders` of a person that hosts have carried out, by kind.
    """

    story: Story
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


def tell(story: Story, *, keep_log: bool = False) -> Verdict:
    """Let a story happen; it ends with the first breach, or when all that may go on have done so."""
    # A story leaves much behind that is in circles: young while it is told, it is found at once afterwards.
    gc.disable()
    try:
        return _told(story, keep_log=keep_log)
    finally:
        gc.collect(0)
        gc.enable()


def _told(story: Story, *, keep_log: bool) -> Verdict:
    judge, outcome = Judge(), OutcomeRecorder()

    def born(name: str, life: Life) -> None:
        judge.born(name, life)
        outcome.born(name, life)

    fleet = judge.fleet = Fleet(
        story.mission,
        story.seed,
        unreachable_after=story.unreachable_after,
        lost_after=story.lost_after,
        keeps=story.journals,
        born=born,
        slowness=story.slowness,
    )
    for disk in fleet.disks.values():
        disk.sync = story.sync
    fleet.timeline.most = MOST_EVENTS
    storm = Storm(fleet, story.forecast, judge.orders)
    # A guard whose host is gone tells the terminal.
    with contextlib.redirect_stderr(io.StringIO()):
        _happen(fleet, storm, judge, story)
        orders = dict(storm.operator.carried_out) if storm.operator else {}
        came_of_it = outcome.digest(fleet, orders, [breach.name for breach in judge.breaches])
        fleet.close()
    said = hashlib.sha256(f"{fleet.digest} {fleet.timeline.events} {storm.faults}".encode()).hexdigest()
    log = tuple(fleet.log) if keep_log else ()
    recovered, faults = judge.seen["recoveries"], tuple(storm.faults)
    counts = judge.calls, judge.restarts, recovered, orders
    return Verdict(story, tuple(judge.breaches), said, came_of_it, fleet.now, faults, *counts, log)


def _happen(fleet: Fleet, storm: Storm, judge: Judge, story: Story) -> None:
    _until(fleet, judge, story.seconds)
    if judge.breaches:
        return
    storm.end()
    if story.journals:
        fleet.recall()
    judge.healed()
    waits = ENOUGH * story.reserved_wait * (story.kind in RESERVES)
    end = fleet.now + PATIENCE + story.unreachable_after + story.interval + waits
    while judge.waits_for() and fleet.now < end and not judge.breaches:
        # One that stood still may end in order, or give the others up, just when all is well again.
        fleet.heal_all()
        if storm.operator is not None:
            storm.operator.free_all()
        if story.journals:
            fleet.recall(exits.UNHEARD)
        _until(fleet, judge, fleet.now + 1.0)
    if story.hosts > MOST_MEMBERS and not judge.breaches:
        settled = fleet.now + SETTLES + story.unreachable_after
        while fleet.now < settled and not judge.breaches:
            if storm.operator is not None:
                storm.operator.free_all()
            _until(fleet, judge, min(settled, fleet.now + 1.0))
        judge.settled()
        _until(fleet, judge, fleet.now + ROAMS)
    if not judge.breaches:
        judge.end()


def _until(fleet: Fleet, judge: Judge, when: float) -> None:
    try:
        while fleet.now < when and not judge.breaches:
            fleet.run(min(LOOK, when - fleet.now))
            judge.look()
    except Endless as error:
        judge.breaches.add("endless", (), str(error))
