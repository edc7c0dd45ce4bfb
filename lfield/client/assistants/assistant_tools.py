"""The tools for AI assistants: a name, the types of the arguments, and a request to a connected team.

Tools that can move hardware are `start` and `call`. Hosts refuse both unless the access file of the mission
lists the person in `assistants`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from lfield.client.team import CALL_TIMEOUT, ConnectedTeam
from lfield.errors import UsageError
from lfield.text.suggestions import did_you_mean
from lfield.vm.person_calls.l_object import LObject
from lfield.wire.fields import MAX_LABEL, truncate
from lfield.wire.person_calls.portal_call_messages import MAX_LIMIT

#: The most events of one answer.
MAX_EVENTS = 1000

Query = Annotated[
    str, Meta(description='a capability, with or without a condition: "Lift where payload >= 2.0"')
]
Hosts = Annotated[list[str], Meta(description="names of hosts")]


class ToolArguments(Struct, frozen=True, forbid_unknown_fields=True):
    """The arguments of a tool; some tools have none."""


class QueryArguments(ToolArguments, frozen=True):
    """A query, the host on which the asking coordinator would be, and a size of teams."""

    query: Query
    at: Annotated[str, Meta(description="rank the agents as a coordinator on this host would")] = ""
    size: Annotated[int, Meta(description="also the best teams of so many agents")] | None = None


class ExplainArguments(ToolArguments, frozen=True):
    """A query."""

    query: Query


class EventArguments(ToolArguments, frozen=True):
    """A selection of the stored events."""

    since: Annotated[int, Meta(description="events after this number of each host; 0 for all")] = 0
    kinds: Annotated[list[str], Meta(description="kinds of events, such as hopped; none for all")] = []
    hosts: Hosts = []
    most: Annotated[int, Meta(ge=1, le=MAX_EVENTS, description="the newest so many of them")] = 100


class StartArguments(ToolArguments, frozen=True):
    """The hosts that are left out."""

    without: Hosts = []


class CallArguments(ToolArguments, frozen=True):
    """A portal of an agent, with its arguments."""

    agent: Annotated[str, Meta(description="the name of a resource in the deployment")]
    portal: Annotated[str, Meta(description="the name of one of its portals")]
    arguments: Annotated[list[Any], Meta(description="numbers, truth values, texts, lists, null")] = []
    timeout: Annotated[float, Meta(gt=0.0, le=MAX_LIMIT, description="time limit in seconds")] = CALL_TIMEOUT


@dataclass(frozen=True, slots=True)
class AssistantTool:
    """One tool; `may_move`: hardware may move."""

    description: str
    arguments: type[ToolArguments]
    run: Callable[[ConnectedTeam, Any], Awaitable[object]]
    may_move: bool = False

    @property
    def schema(self) -> dict[str, Any]:
        """The JSON schema of the tool's arguments."""
        (_,), parts = msgspec.json.schema_components([self.arguments])
        return dict(parts[self.arguments.__name__])

    def parse(self, arguments: Mapping[str, Any]) -> ToolArguments:
        """The arguments in their types. Raises UsageError."""
        try:
            return msgspec.convert(dict(arguments), self.arguments)
        except msgspec.ValidationError as error:
            raise UsageError(f"the arguments are not valid: {error}") from None


async def _status(team: ConnectedTeam, _: ToolArguments) -> object:
    return await team.status()


async def _query(team: ConnectedTeam, arguments: QueryArguments) -> object:
    return await team.query(arguments.query, at=arguments.at, size=arguments.size)


async def _explain(team: ConnectedTeam, arguments: ExplainArguments) -> object:
    return await team.explain(arguments.query)


async def _events(team: ConnectedTeam, arguments: EventArguments) -> object:
    newest, count = deque[Mapping[str, object]](maxlen=arguments.most), 0
    async for event in team.events(
        since=arguments.since, kinds=arguments.kinds, hosts=arguments.hosts, follow=False
    ):
        newest.append(event)
        count += 1
    return {"events": list(newest), "left_off": count - len(newest)}


async def _start(team: ConnectedTeam, arguments: StartArguments) -> object:
    return await team.start(without=arguments.without)


async def _call(team: ConnectedTeam, arguments: CallArguments) -> object:
    value = await team.call(
        arguments.agent, arguments.portal, *arguments.arguments, timeout=arguments.timeout
    )
    return {"value": value}


TOOLS: Mapping[str, AssistantTool] = {
    "status": AssistantTool(
        "The state of each host: agents, devices, leases, links; or why it does not answer.",
        ToolArguments,
        _status,
    ),
    "query": AssistantTool(
        "The agents that provide a capability, with scores, and the reasons why others do not.",
        QueryArguments,
        _query,
    ),
    "explain": AssistantTool(
        "By agent the reasons why it does not provide a capability.", ExplainArguments, _explain
    ),
    "events": AssistantTool(
        "Stored events of the hosts: migrations, calls, log lines, ends. An object of the kind 'lost' is for "
        "events that are missing.",
        EventArguments,
        _events,
    ),
    "start": AssistantTool(
        "Start the signed mission that is active on the robots of the inventory. Vehicles may move.",
        StartArguments,
        _start,
        may_move=True,
    ),
    "call": AssistantTool(
        "Call a portal of an agent once, and return its value. Hardware may move.",
        CallArguments,
        _call,
        may_move=True,
    ),
}


def find_tool(name: str) -> AssistantTool:
    """The tool of that name. Raises UsageError."""
    if name not in TOOLS:
        hint = did_you_mean(name, list(TOOLS)) or f"there are {', '.join(TOOLS)}"
        raise UsageError(f"there is no tool '{truncate(name, MAX_LABEL)}': {hint}")
    return TOOLS[name]


def as_json(value: object) -> str:
    """A result as JSON; objects of L are their fields, with the class as `class`. NaN and infinities are
    null."""
    return msgspec.json.encode(value, enc_hook=_plain).decode()


def _plain(value: object) -> Mapping[str, object] | Sequence[object]:
    if isinstance(value, LObject):
        return {"class": value.class_name, **value.fields}
    raise TypeError(f"{type(value).__name__} is no value of L")
