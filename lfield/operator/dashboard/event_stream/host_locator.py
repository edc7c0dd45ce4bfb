"""Locates the hosts of a mission, also after a restart in another run with other sockets.

A run on this computer has its own directory with its own sockets, so a restart changes them. The address of a
host on a network is that of its deployment or of `--map`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

from lfield.errors import AddressError, LfieldError
from lfield.operator.targets import TargetTeam

#: Minimum seconds between two searches for runs, however many hosts are missing.
REFRESH_INTERVAL = 1.0
#: Another possible reason why a host is not found.
NOT_RUNNING = "the mission may not run there (yet)"


class HostLocator:
    """The hosts of a team. `find` returns the present teams of the same mission; it may read files, and
    raises LfieldError if none is found.
    """

    def __init__(self, team: TargetTeam, find: Callable[[], Sequence[TargetTeam]]) -> None:
        self._team, self._find = team, find
        self._refreshed_at: float | None = None
        self._refresh = asyncio.Lock()

    @property
    def hosts(self) -> tuple[str, ...]:
        """The names of the hosts, in the order of the team."""
        return tuple(self._team.addresses)

    @property
    def addresses(self) -> Mapping[str, str]:
        """The last known addresses of the hosts."""
        return self._team.addresses

    def hint(self) -> str:
        """A hint for a host that is not at its expected address; '' for none."""
        return "" if self._team.runs else NOT_RUNNING

    async def __call__(self, host: str) -> str:
        """The present address of a host. Raises AddressError for one that is no longer in the mission."""
        async with self._refresh:
            now = asyncio.get_running_loop().time()
            if self._refreshed_at is None:
                # The team was searched for a moment ago.
                self._refreshed_at = now
            elif now >= self._refreshed_at + REFRESH_INTERVAL:
                self._refreshed_at = now
                self._choose(await asyncio.to_thread(self._found))
        address = self._team.addresses.get(host)
        if address is None:
            raise AddressError(host, "the running mission no longer has such a host")
        return address

    def _found(self) -> Sequence[TargetTeam]:
        with suppress(LfieldError):
            return self._find()
        return ()

    def _choose(self, targets: Sequence[TargetTeam]) -> None:
        """Choose among several runs of the mission the one that was followed, or else the newest, which is
        the last.

        If none was followed yet, any run is of the mission that was named. A run of another user does not
        replace a trusted one.
        """
        followed = self._team
        own_targets = [p for p in targets if p.runs and p.user == followed.user]
        if followed.runs:
            own_targets = [target for target in own_targets if target.mission == followed.mission]
        if own_targets:
            same_run = [target for target in own_targets if target.id == followed.id]
            self._team = (same_run or own_targets)[-1]
