"""I5: at every moment some disk holds a state from which a coordinator can go on, unless it ended.

What is asked of whoever simulates journals: what the disk of a host would give if the host began now.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

#: What a copy's page may say of a copy that may run, or have to run again.
GOES_ON = ("RUN", "PREPARED")


class CopyPage(Protocol):
    """What is read of a journal's page of a copy; other pages have no `state` and are not looked at."""

    @property
    def agent(self) -> str:
        """Of which coordinator."""

    @property
    def generation(self) -> int:
        """Of which start of it."""

    @property
    def state(self) -> str:
        """What the copy is, as in lfield/mobility/copies.py."""

    @property
    def block(self) -> bytes:
        """Its state; b'' for none."""


class Disks(Protocol):
    """The disks of a team."""

    def pages(self, host: str) -> Iterable[object]:
        """What is on the disk of a host now, and would be there after a crash in this moment."""


def nowhere(disks: Disks, hosts: Iterable[str], newest: Mapping[str, int]) -> list[str]:
    """The coordinators of which no disk holds a state to go on from; `newest` has the start of each."""
    saved = {
        (page.agent, page.generation)
        for host in hosts
        for page in copies(disks.pages(host))
        if page.state in GOES_ON and page.block
    }
    return [agent for agent, generation in newest.items() if (agent, generation) not in saved]


def copies(pages: Iterable[object]) -> Iterable[CopyPage]:
    """Those of some pages that are of a copy."""
    return (page for page in pages if hasattr(page, "state"))  # type: ignore[misc]
