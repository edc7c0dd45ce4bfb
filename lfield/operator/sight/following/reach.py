"""Where the hosts of a mission are found, also after they were started again: another run, other doors.

A run of this computer has sockets of its own in a folder of its own, so one that is started again is not
where the last one was. A host over a network stays where its deployment, or `--map`, says.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

from lfield.errors import AddressError, LfieldError
from lfield.operator.addressed import Party

#: Runs are looked for once in so many seconds, however many hosts are missed.
LOOKED_EVERY = 1.0
#: What else can be the matter with a host that is not found.
NOT_HERE = "this mission does not run on this computer (yet)"


class Reach:
    """The hosts of a party. `look` finds the parties of the same mission that there are now; it may read
    files, and raise LfieldError where nothing is found."""

    def __init__(self, party: Party, look: Callable[[], Sequence[Party]]) -> None:
        self._party, self._look = party, look
        self._looked: float | None = None
        self._looking = asyncio.Lock()

    @property
    def hosts(self) -> tuple[str, ...]:
        """Their names, in the order of the team."""
        return tuple(self._party.addresses)

    @property
    def addresses(self) -> Mapping[str, str]:
        """Where they were found last."""
        return self._party.addresses

    def hint(self) -> str:
        """What to say of a host that is not where it was looked for; '' for nothing more."""
        return "" if self._party.runs else NOT_HERE

    async def __call__(self, host: str) -> str:
        """Where a host is now. Raises AddressError for one that the mission has no more."""
        async with self._looking:
            now = asyncio.get_running_loop().time()
            if self._looked is None:
                # What the party was made of was looked for a moment ago.
                self._looked = now
            elif now >= self._looked + LOOKED_EVERY:
                self._looked = now
                self._take(await asyncio.to_thread(self._found))
        address = self._party.addresses.get(host)
        if address is None:
            raise AddressError(host, "the mission that runs here has no such host any more")
        return address

    def _found(self) -> Sequence[Party]:
        with suppress(LfieldError):
            return self._look()
        return ()

    def _take(self, parties: Sequence[Party]) -> None:
        """Of several runs of the mission the one that was followed, or else the newest, which is the last.

        Where none was followed yet, whatever runs now is of the mission that was named. One of another user
        does not take the place of one that is believed.
        """
        followed = self._party
        own = [p for p in parties if p.runs and p.user == followed.user]
        if followed.runs:
            own = [party for party in own if party.mission == followed.mission]
        if own:
            same = [party for party in own if party.id == followed.id]
            self._party = (same or own)[-1]
