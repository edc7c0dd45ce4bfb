"""What every link of an observer does alike: no coordinator comes over it, and a lot may."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.errors import WireError

if TYPE_CHECKING:
    from lfield.errors import OverBudget
    from lfield.net.transport import Link
    from lfield.wire.coordinators import Transfer


class ObserverLink:
    """The handler of one link of an observer, but for messages and its end."""

    def on_transfer(self, link: Link, header: Transfer, block: memoryview) -> None:
        """Nobody sends one to an observer."""
        raise WireError("a coordinator was sent to an observer")

    def on_oversize(self, link: Link, header: Transfer, size: int) -> None:
        """Nor a larger one."""
        raise WireError("a coordinator was sent to an observer")

    def on_excess(self, link: Link, error: OverBudget) -> None:
        """A host sends more than this computer can show: it is read more slowly, and closed in the end."""
