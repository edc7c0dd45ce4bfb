"""The environment of the service of a host: its disk, the mission's host, and the services of other hosts."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection
from typing import Protocol

from lfield.errors import LfieldError
from lfield.service.bundle_receiver import BundleFiles
from lfield.service.bundle_store import ServiceRecord
from lfield.wire.service_messages import ServiceMessage, ServiceQuery, UnfinishedCoordinator, VoteQuery

#: The reason of coordinators that an operator has discarded.
DISCARDED = "discarded by 'lfield stop --discard'"


class ServiceFiles(BundleFiles, Protocol):
    """The disk of a service (`bundle_store.BundleStore`)."""

    def save(self, record: ServiceRecord) -> None:
        """Replace the state. Raises OutputFileError."""


class MissionProbe(Protocol):
    """Observes the mission's host and its journals (`mission_probe.LocalProbe`)."""

    async def vehicles(self) -> str:
        """The reason why the vehicles of a running host are not all at rest on the ground; '' if they are."""

    async def unfinished(self) -> list[UnfinishedCoordinator]:
        """The coordinators that have not ended."""

    async def hold(self, ballot: bytes) -> str:
        """Hold the running host until the result of a ballot, so that no vehicle arms; returns the reason
        why it is not at rest, or ''. No person can end this hold, and a pause of a person is separate.
        """

    async def release(self) -> str:
        """End the hold of the running host for any ballot; returns the reason why it is still held, or ''."""

    async def is_up(self) -> bool:
        """Whether the running host has opened its devices."""

    async def condition(self) -> str:
        """The reason why the running host waits or is paused; '' if it does not."""

    async def start_without(self, hosts: list[str]) -> str:
        """End the wait of the running host's coordinators for some hosts; returns the reason why they
        still wait.
        """

    async def discard(self, mission: str = "", reason: str = DISCARDED) -> list[str]:
        """End the coordinators in the journals of a host that does not run, or of one mission of it; returns
        their names.
        """


#: Asks the service of another host. Raises LfieldError.
AskPeer = Callable[[str, VoteQuery | ServiceQuery], Awaitable[ServiceMessage]]


async def ask_peers(
    ask: AskPeer, hosts: Collection[str], query: VoteQuery | ServiceQuery
) -> list[ServiceMessage]:
    """The answers of the services of other hosts, without those that do not answer."""
    answers = await asyncio.gather(*(ask(host, query) for host in hosts), return_exceptions=True)
    found = []
    for answer in answers:
        if not isinstance(answer, BaseException):
            found.append(answer)
        elif not isinstance(answer, LfieldError):
            raise answer
    return found
