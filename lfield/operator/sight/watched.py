"""A team while somebody looks at it: its picture, kept up to date by a follower, and what can be ordered.

async with watched(path, team, party, look, keys) as team:
    team.seen(); await team.actions.stop()
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from lfield.clock import Clock, SystemClock
from lfield.errors import LfieldError
from lfield.mission import bundle
from lfield.mission.access.rules import UNWRITTEN
from lfield.mission.load import load_mission
from lfield.mission.mission import Mission
from lfield.mission.team import Team
from lfield.operator.addressed import Party
from lfield.operator.ask import brought, desk_with, observer, own_keys
from lfield.operator.orders.known_hosts import KnownHosts
from lfield.operator.query import Asked, read_asked
from lfield.operator.sight.actions import Actions, Order
from lfield.operator.sight.following.beside import beside
from lfield.operator.sight.following.follower import Follower
from lfield.operator.sight.following.reach import Reach
from lfield.operator.sight.listening import said_before
from lfield.operator.sight.orders import Orders
from lfield.operator.sight.picture.roll import Roll, roll_of
from lfield.operator.sight.picture.team_picture import Picture
from lfield.operator.sight.seen import Curve, Seen
from lfield.operator.sight.timeline.timeline import Dated
from lfield.wire.observing import EmergencyStopped
from lfield.wire.orders import Epochs
from lfield.wire.watching import Events

#: How often a second each device and agent is told of.
RATE = 5.0
#: Curves grow every so many seconds.
TICK = 1.0


class Watched:
    """Implements `Sight`, `Hearer` for a follower, `Witness` for orders; `actions` gives these."""

    actions: Actions

    def __init__(self, roll: Roll, clock: Clock) -> None:
        self._ahead = clock.time() - clock.monotonic()
        self.picture = Picture(roll, self._ahead)
        self._clock = clock

    def seen(self) -> Seen:
        """How the team is now."""
        return self.picture.seen(self._clock.monotonic())

    def curves(self) -> tuple[Curve, ...]:
        """What is plotted, of the last minutes."""
        return self.picture.curves(self._clock.monotonic())

    def linked(self, host: str) -> None:
        """See `Hearer.linked`."""
        self.picture.linked(host)

    def unlinked(self, host: str, why: str) -> None:
        """See `Hearer.unlinked`."""
        self.picture.unlinked(host, why)

    def told(self, host: str, batch: Events, took: float | None) -> None:
        """See `Hearer.told`."""
        self.picture.told(host, batch, self._clock.monotonic(), self._clock.time(), took)

    def ordered(self, order: Order, hosts: Collection[str]) -> int:
        """See `Witness.ordered`."""
        return self.picture.ordered(order, hosts, self._clock.monotonic())

    def answered(self, number: int, host: str, answer: EmergencyStopped | LfieldError) -> None:
        """See `Witness.answered`."""
        self.picture.answered(number, host, answer)

    async def begin_log(self, said: Awaitable[Sequence[Dated]]) -> None:
        """Begin the log with what hosts had said before they were looked at."""
        self.picture.log_waits()
        told = await said
        self.picture.log_begins((d.host, d.incarnation, d.event, d.time - self._ahead) for d in told)

    async def tick(self) -> None:
        """Let curves grow until this is cancelled."""
        while True:
            self.picture.tick(self._clock.monotonic())
            await asyncio.sleep(TICK)


def read_mission(path: Path) -> Mission | None:
    """The mission that a team flies, as its files say; None where there are mistakes in them.

    A team can be watched whatever has become of the program on this computer.
    """
    try:
        is_bundle = path.suffix == bundle.SUFFIX
        # Whether its devices are fakes does not change what they tell.
        return bundle.read(path) if is_bundle else load_mission(path, simulate=True)
    except LfieldError:
        return None


def _keep_nothing(host: str, epochs: Epochs) -> None:
    """Hosts at Unix sockets get no datagrams."""


@asynccontextmanager
async def watched(
    path: Path, team: Team, party: Party, look: Callable[[], Sequence[Party]], keys: Path | None = None
) -> AsyncIterator[Watched]:
    """The team of a mission while it is looked at; `look` finds its hosts anew, `keys` says where those of
    this user should be.

    Raises KeysError for keys that cannot be used.
    """
    clock = SystemClock()
    own = own_keys(party.addresses.values(), keys)
    desk = desk_with(own, KnownHosts.read(own.authority)) if own is not None else None
    transport, brings = observer(own, desk.known if desk is not None else None), brought(own)
    reach = Reach(party, look)
    mission = await asyncio.to_thread(read_mission, path)
    shown = Watched(roll_of(path.stem, team, mission), clock)
    access = mission.access if mission is not None else UNWRITTEN

    def asked() -> Asked:
        return read_asked(path, team)

    follower = Follower(
        transport,
        reach.hosts,
        reach,
        shown,
        clock,
        telemetry=RATE,
        brings=brings,
        hint=reach.hint,
        learn=desk.learn if desk is not None else _keep_nothing,
    )
    shown.actions = Orders(
        transport,
        reach,
        shown,
        team,
        asked,
        own,
        brings,
        access=access,
        desk=desk,
        standing=follower.order,
    )
    past = said_before(transport, reach.hosts, reach, clock, brings)
    async with beside(shown.begin_log(past), follower.run(), shown.tick()):
        yield shown
