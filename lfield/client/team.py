"""A connected team, for programs in Python: the same requests as those of the commands, with the same rights.

async with connect() as team:
    await team.query("Lift where payload >= 2.0")
    async for event in team.events(until_done=True): ...
    await team.call("arm1", "grab", 0.1, timeout=20.0)
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Collection, Coroutine, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from weakref import WeakSet

from lfield.client.capability_query import TeamQueries
from lfield.client.event_json import event_data
from lfield.client.mission_start import StartResult, plan_start, start_mission
from lfield.client.mission_stop import hosts_to_stop, stop_mission
from lfield.client.portal_call import PortalCaller
from lfield.client.service_desk import FleetDesk, open_service_desk
from lfield.client.status_json import status_data
from lfield.client.team_actions import stop_order
from lfield.client.team_connection import open_connection
from lfield.client.team_selection import TeamSelection
from lfield.client.team_watch import read_mission
from lfield.clock import SystemClock
from lfield.errors import LfieldError, UsageError
from lfield.mission.mission import Mission
from lfield.operator.client import FULL_SNAPSHOT, PATIENT_SNAPSHOT, pause
from lfield.operator.dashboard.event_feed import FeedNotice, open_feed
from lfield.operator.dashboard.event_stream.background_task import background_tasks
from lfield.operator.observer_link import Request
from lfield.operator.targets import TargetTeam, display_names, open_team, running_mission
from lfield.operator.team_model.host_model import host_states
from lfield.operator.team_model.mission_end import MissionEnd
from lfield.wire.events import KINDS, TELEMETRY
from lfield.wire.fields import MAX_COUNT
from lfield.wire.observer_messages import EmergencyStopResult
from lfield.wire.subscription_messages import MAX_RATE

#: The default time limit of a portal call, in seconds.
CALL_TIMEOUT = 60.0
#: Seconds for a connection: hosts accept many clients one after the other.
CONNECT_TIMEOUT = 8.0
#: Seconds without contact after which `events(until_done=True)` does not wait for a host.
LOST_AFTER = 15.0
#: Seconds for cancellations that are under way when a team is closed.
CLOSE_TIMEOUT = 5.0


class ConnectedTeam:
    """The hosts of one team. `connect` makes it; all methods raise errors of `lfield.errors`."""

    def __init__(self, selection: TeamSelection, target: TargetTeam, *, is_assistant: bool = False) -> None:
        """Raises KeysError for keys that cannot be used."""
        self._selection, self._target, self._is_assistant = selection, target, is_assistant
        self._connection = open_connection(target, self._find, selection.keys, CONNECT_TIMEOUT)
        self._tasks: set[asyncio.Task[None]] = set()
        #: The event streams that a loop may have left before their end.
        self._streams: WeakSet[AsyncGenerator[dict[str, object], None]] = WeakSet()
        self._queries: TeamQueries | None = None
        self._caller = PortalCaller(self._connection, self._spawn, is_assistant=is_assistant)

    @property
    def hosts(self) -> Sequence[str]:
        """The names of the hosts."""
        return self._connection.locate.hosts

    def _find(self) -> Sequence[TargetTeam]:
        return self._selection.teams(self._selection.runs())

    def _spawn(self, work: Coroutine[object, object, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """End the event streams, and complete the cancellations under way, for at most `CLOSE_TIMEOUT`
        seconds."""
        for stream in list(self._streams):
            await stream.aclose()
        if self._tasks:
            _, late = await asyncio.wait(self._tasks, timeout=CLOSE_TIMEOUT)
            for task in late:
                task.cancel()

    # --- questions ------------------------------------------------------------------------------------

    async def status(self) -> dict[str, object]:
        """The state of every host, or the error where it did not answer: as `lfield ps MISSION --json`."""
        return status_data(host_states(await self._connection.snapshots(FULL_SNAPSHOT)))

    async def query(self, text: str, *, at: str = "", size: int | None = None) -> dict[str, object]:
        """The agents that provide a capability, and the reasons against others: as `lfield query --json`.

        `at` ranks them as a coordinator on that host would, `size` adds the best teams of so many agents.
        Raises ProgramError for mistakes in the query.
        """
        snapshots = await self._connection.snapshots(PATIENT_SNAPSHOT)
        if self._queries is None:
            self._queries = await asyncio.to_thread(self._read_queries)
        return await self._queries.data(text, snapshots, at, size)

    async def explain(self, text: str) -> dict[str, Sequence[str]]:
        """By agent, the reasons why it does not provide a capability, or not under the condition of the
        query.
        """
        found = await self.query(text)
        reasons: dict[str, Sequence[str]] = {}
        for answer in _rows(found["capabilities"]):
            for refusal in _rows(answer["refusals"]):
                reasons[str(refusal["subject"])] = _reasons(refusal)
        return reasons

    def _read_queries(self) -> TeamQueries:
        path = self._mission_path()
        return TeamQueries(path, open_team(path))

    def _mission_path(self) -> Path:
        return self._selection.mission or running_mission(list(self._target.runs))

    # --- events ---------------------------------------------------------------------------------------

    def events(
        self,
        *,
        since: int | None = None,
        kinds: Collection[str] = (),
        hosts: Collection[str] = (),
        rate: float = 0.0,
        until_done: bool = False,
        follow: bool = True,
    ) -> AsyncIterator[dict[str, object]]:
        """Events in order, as `lfield events --json`; of all kinds and hosts unless some are named.

        `since` 0: also the stored ones. `rate` is that of telemetry in Hz. With `until_done` the stream ends
        when all coordinators have ended, without `follow` after the stored events, which it includes by
        default. An object of the kind 'lost' counts events that were lost. Raises UsageError for an unknown
        kind or host, or a number out of range.
        """
        self._check(kinds, KINDS, "kind of events")
        self._check(hosts, self.hosts, "host")
        if since is not None and not 0 <= since <= MAX_COUNT:
            raise UsageError(f"events are numbered from 1: since {since} is not possible")
        if not 0.0 <= rate <= MAX_RATE:
            raise UsageError(f"the rate must be from 0 to {MAX_RATE:g} Hz")
        stream = self._events(
            0 if since is None and not follow else since, kinds, hosts, rate, until_done, follow
        )
        self._streams.add(stream)
        return stream

    async def _events(
        self,
        since: int | None,
        kinds: Collection[str],
        hosts: Collection[str],
        rate: float,
        until_done: bool,
        follow: bool,
    ) -> AsyncGenerator[dict[str, object], None]:
        names = display_names([self._target])
        end = (
            MissionEnd(list(self.hosts), await self._homes(), LOST_AFTER, SystemClock())
            if until_done
            else None
        )
        async with (
            open_feed(
                [self._target],
                names,
                self._find,
                self._selection.keys,
                since=since,
                telemetry=rate if TELEMETRY & set(kinds or KINDS) else 0.0,
                observer=end,
            ) as feed,
            background_tasks(*([feed.follow_end(end)] if end is not None else [])),
        ):
            async for item in feed.events(follow=follow, until=end.is_over if end is not None else _never):
                if isinstance(item, FeedNotice):
                    if item.lost:
                        yield event_data(item)
                elif (not kinds or item.event.kind in kinds) and (not hosts or item.host in hosts):
                    yield event_data(item)
            for host, reason in () if follow else feed.unreached.items():
                yield event_data(FeedNotice(host, reason, {"events": None}))

    def _check(self, named: Collection[str], known: Collection[str], kind: str) -> None:
        for name in named:
            if name not in known:
                raise UsageError(f"unknown {kind} '{name}': there are {', '.join(sorted(known))}")

    async def _homes(self) -> dict[str, str] | None:
        """The home of each coordinator; None if the files of the mission are not on this computer."""
        mission: Mission | None = None
        with suppress(LfieldError):
            mission = await asyncio.to_thread(read_mission, self._mission_path())
        if mission is None:
            return None
        return {member.id: mission.team.homes[member.id] for member in mission.team.coordinators}

    # --- portals --------------------------------------------------------------------------------------

    async def call(
        self, agent: str, portal: str, *arguments: object, timeout: float = CALL_TIMEOUT
    ) -> object:
        """The value that a portal of an agent returns, if the access file of the mission opens it.

        The host of the agent executes the call once, and cancels it after `timeout` seconds, or when this
        task is cancelled. Raises PortalCallRefused before it has started, PortalFailed for an exception of L,
        and CallOutcomeUnknown if the host was lost.
        """
        return await self._caller.call(agent, portal, arguments, timeout)

    # --- orders ---------------------------------------------------------------------------------------

    async def start(self, *, without: Sequence[str] = ()) -> dict[str, object]:
        """Start the mission whose signed bundle is active on the robots of the inventory: as `lfield start
        --json`. Needs the right to command."""
        desk = await self._desk()
        plan = await plan_start(desk, without)
        found = plan if isinstance(plan, StartResult) else await start_mission(desk, plan)
        return found.as_data()

    async def stop(self, *, without: Sequence[str] = (), discard: bool = False) -> dict[str, object]:
        """Stop the mission on the robots of the inventory in order: as `lfield stop --json`. With `discard`
        its coordinators end too."""
        desk = await self._desk()
        return (await stop_mission(desk, hosts_to_stop(desk, without), discards=discard)).as_data()

    async def _desk(self) -> FleetDesk:
        selection, is_assistant = self._selection, self._is_assistant
        return await asyncio.to_thread(
            open_service_desk, selection.inventory, selection.keys, is_assistant=is_assistant
        )

    async def emergency_stop(self, reason: str = "") -> dict[str, object]:
        """Bring every device of every host into its safe state: by host and device, '' or why not."""
        return await self._order(stop_order(reason))

    async def pause(self) -> dict[str, object]:
        """Suspend all agents, and bring devices into their safe states; the result as of `emergency_stop`."""
        return await self._order(pause())

    async def resume(self) -> dict[str, object]:
        """Resume a paused mission; the result as of `emergency_stop`."""
        return await self._order(pause(lift=True))

    async def _order(self, request: Request[EmergencyStopResult]) -> dict[str, object]:
        answers = await self._connection.order(request)
        return {
            host: answer.as_data() if isinstance(answer, LfieldError) else dict(answer.devices)
            for host, answer in answers.items()
        }


@asynccontextmanager
async def connect(
    mission: Path | str | None = None,
    *,
    run: str = "",
    maps: Sequence[str] = (),
    inventory: Path | None = None,
    keys: Path | None = None,
    is_assistant: bool = False,
) -> AsyncIterator[ConnectedTeam]:
    """The team of a mission (a deployment or a bundle), of a `run` on this computer, or of an inventory.

    Without arguments: the mission that runs on this computer, else the hosts of the default inventory.
    `maps` are addresses `NAME=ADDR:PORT`, `keys` is the folder with the keys of this person. With
    `is_assistant` hosts treat calls and starts as those of an AI assistant. Raises UsageError,
    NoMissionRunning, KeysError.
    """
    path = Path(mission) if mission is not None else None
    selection = TeamSelection(path, run, maps, inventory, keys)
    target, _ = await asyncio.to_thread(selection.single)
    team = ConnectedTeam(selection, target, is_assistant=is_assistant)
    try:
        yield team
    finally:
        await team.close()


def _never() -> bool:
    return False


def _rows(value: object) -> list[dict[str, object]]:
    return value if isinstance(value, list) else []


def _reasons(refusal: Mapping[str, object]) -> Sequence[str]:
    """The reasons of a refusal, and of the refusals inside it."""
    own = refusal["reasons"]
    texts = [str(reason) for reason in own] if isinstance(own, list) else []
    return [*texts, *(text for inner in _rows(refusal["inner"]) for text in _reasons(inner))]
