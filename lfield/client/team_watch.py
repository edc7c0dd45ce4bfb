"""A watched team: its state, kept up to date by an `EventFollower`, and the actions of an operator.

async with watch_team(path, team, targets, find, keys) as watch:
    watch.snapshot(); await watch.actions.stop()
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from lfield.client.capability_query import TeamQueries
from lfield.client.team_actions import TeamActions
from lfield.client.team_connection import open_connection
from lfield.clock import Clock, SystemClock
from lfield.errors import LfieldError
from lfield.geodata.map_drawings import MapDrawing
from lfield.mission import bundle
from lfield.mission.access.access_rules import NO_RULES
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.mission.team import Team
from lfield.operator.dashboard.event_feed import log_backlog
from lfield.operator.dashboard.event_stream.background_task import background_tasks
from lfield.operator.dashboard.event_stream.event_follower import EventFollower, FollowOptions
from lfield.operator.dashboard.map_files import program_drawings
from lfield.operator.dashboard.operator_actions import OperatorActions
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
from lfield.operator.targets import TargetTeam
from lfield.operator.team_model.team_contents import TeamContents, team_contents
from lfield.operator.team_model.team_state import Curve, TeamState, TrackUpdate
from lfield.operator.team_model.team_view import TeamView
from lfield.wire.observer_messages import EmergencyStopResult
from lfield.wire.order_messages import Epochs, OrderKind
from lfield.wire.subscription_messages import EventBatch

#: Telemetry rate of each device and agent, per second.
RATE = 5.0
#: Seconds between two points of the curves.
TICK = 1.0


class TeamWatch:
    """Implements `TeamStateSource`, `StreamHandler` and `OrderObserver`; `actions` sends orders.

    `drawings` are the plans and areas that the program names.
    """

    actions: OperatorActions

    def __init__(self, inventory: TeamContents, clock: Clock, drawings: Sequence[MapDrawing] = ()) -> None:
        self.drawings = drawings
        self.view = TeamView(inventory)
        self._clock = clock

    def snapshot(self) -> TeamState:
        return self.view.snapshot(self._clock.monotonic())

    def curves(self) -> tuple[Curve, ...]:
        """The curves of the last minutes."""
        return self.view.curves(self._clock.monotonic())

    def tracks(self, after: int) -> TrackUpdate:
        """The tracks of the vehicles after a point number."""
        return self.view.tracks(after)

    def on_linked(self, host: str) -> None:
        """See `StreamHandler.on_linked`."""
        self.view.on_linked(host)

    def on_unlinked(self, host: str, reason: str) -> None:
        """See `StreamHandler.on_unlinked`."""
        self.view.on_unlinked(host, reason)

    def on_batch(self, host: str, batch: EventBatch, took: float | None) -> None:
        """See `StreamHandler.on_batch`."""
        self.view.feed(host, batch, self._clock.monotonic(), self._clock.time(), took)

    def on_order(self, order: OrderKind, hosts: Collection[str]) -> int:
        """See `OrderObserver.on_order`."""
        return self.view.on_order(order, hosts, self._clock.monotonic())

    def on_answer(self, number: int, host: str, answer: EmergencyStopResult | LfieldError) -> None:
        """See `OrderObserver.on_answer`."""
        self.view.on_answer(number, host, answer)

    async def start_log(self, backlog: Awaitable[Sequence[DatedEvent]]) -> None:
        """Start the log with the backlog of the hosts."""
        self.view.hold_log()
        stored = await backlog
        now, wall = self._clock.monotonic(), self._clock.time()
        self.view.start_log(((d.host, d.incarnation, d.event) for d in stored), now, wall)

    async def tick(self) -> None:
        """Extend the curves until cancelled."""
        while True:
            self.view.tick(self._clock.monotonic())
            await asyncio.sleep(TICK)


def read_mission(path: Path) -> Mission | None:
    """The mission of a team from its files; None if they have mistakes.

    A team can be watched even if its program is not on this computer.
    """
    try:
        is_bundle = path.suffix == bundle.SUFFIX
        # Simulated devices have the same quantities as real ones.
        return bundle.read(path) if is_bundle else load_mission(path, simulate=True)
    except LfieldError:
        return None


def _ignore_epochs(host: str, epochs: Epochs) -> None:
    """Hosts at Unix sockets get no datagrams."""


@asynccontextmanager
async def watch_team(
    path: Path,
    team: Team,
    targets: TargetTeam,
    find: Callable[[], Sequence[TargetTeam]],
    keys: Path | None = None,
) -> AsyncIterator[TeamWatch]:
    """Watch the team of a mission; `find` locates its hosts again, `keys` is the folder of this user's keys.

    Raises KeysError for keys that cannot be used.
    """
    clock = SystemClock()
    connection = open_connection(targets, find, keys)
    transport, reach, sender = connection.transport, connection.locate, connection.sender
    mission = await asyncio.to_thread(read_mission, path)
    drawings = program_drawings(mission.program) if mission is not None else []
    watch = TeamWatch(team_contents(path.stem, team, mission), clock, drawings)
    options = FollowOptions(
        telemetry=RATE,
        crl=connection.crl,
        hint=reach.hint,
        learn=sender.learn if sender is not None else _ignore_epochs,
    )
    follower = EventFollower(transport, reach.hosts, reach, watch, clock, options)
    access = mission.access if mission is not None else NO_RULES
    watch.actions = TeamActions(connection, watch, lambda: TeamQueries(path, team), access, follower.order)
    past = log_backlog(transport, reach.hosts, reach, clock, connection.crl)
    async with background_tasks(watch.start_log(past), follower.run(), watch.tick()):
        yield watch
