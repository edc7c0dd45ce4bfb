"""Which orders to stop and to pause a host executes: every one once, and none that may be old. Pure.

No clock decides. A host has two random numbers, its `Epochs`, and an order names one of them:

    | order          | names  | which is new with                                     |
    |----------------|--------|-------------------------------------------------------|
    | stop, pause    | `hold` | each life of the host, each executed end              |
    | lift, resume   | `end`  | each life, each executed stop or pause, each lock-out |

So a copy of a stop that was lifted names an epoch that is over, and an end cannot end what came after it was
given. An order that names another number is not executed: whoever still wants it is challenged to name the
present one. Ids that are forgotten do no harm: in the same epoch nothing has ended what such a copy holds.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from typing import Literal

from lfield.journal.pages import Page, Paused, Stopped
from lfield.wire.orders import EPOCH_SIZE, HOLDS, UNKNOWN, Epochs, Kind

#: What an order to end one ends.
Hold = Literal["stop", "pause"]
#: What became of an order, or is to be done with it.
Standing = Literal["new", "holds", "ended", "done", "old", "unknown"]
#: So many ids of executed orders are remembered.
MOST = 128


def hold_of(kind: Kind) -> Hold:
    """What an order begins or ends."""
    return "stop" if kind in ("stop", "lift") else "pause"


class Executed:
    """The orders that one host has executed. `draw` gives random bytes, so many.

    `kept` are the ids of the last orders before this life, each with whether that still holds.
    """

    def __init__(self, draw: Callable[[int], bytes], kept: Mapping[bytes, tuple[Kind, bool]] | None = None):
        self._draw = draw
        self.epochs = Epochs(self._new(), self._new())
        self._orders: OrderedDict[bytes, tuple[Kind, bool]] = OrderedDict(kept or {})

    @staticmethod
    def kept(pages: Iterable[Page]) -> dict[bytes, tuple[Kind, bool]]:
        """The ids of the last orders that the pages of a journal have, each with whether it still holds."""
        found: dict[bytes, tuple[Kind, bool]] = {}
        for page in pages:
            if isinstance(page, Stopped) and page.order:
                found[page.order] = ("stop", True) if page.reason else ("lift", False)
            elif isinstance(page, Paused) and page.order:
                found[page.order] = ("pause", True) if page.on else ("resume", False)
        return found

    def standing(self, kind: Kind, id: bytes, epoch: bytes) -> Standing:
        """What is to be done with an order that came.

        `new`: execute it. `holds`, `ended` and `done`: it was executed, and only confirmed again; a stop or
        pause still holds or has ended, an end is done. `old`: it names a number that is over, and `unknown`
        none at all.
        """
        known = self._orders.get(id)
        if known is not None:
            found, holds = known
            return ("holds" if holds else "ended") if found in HOLDS else "done"
        if epoch == self.epochs.of(kind):
            return "new"
        return "unknown" if epoch == UNKNOWN else "old"

    def execute(self, kind: Kind, id: bytes) -> None:
        """An order is executed: it never is again."""
        if kind in HOLDS:
            self.epochs = Epochs(self.epochs.hold, self._new())
        else:
            # `end` stays: two ends that are given at one time, of a stop and of a pause, are both executed.
            self.epochs = Epochs(self._new(), self.epochs.end)
            for other, (was, holds) in self._orders.items():
                if holds and hold_of(was) == hold_of(kind):
                    self._orders[other] = (was, False)
        self._orders[id] = (kind, kind in HOLDS)
        if len(self._orders) > MOST:
            self._orders.popitem(last=False)

    def locked_out(self) -> None:
        """A device is locked out, which holds as a stop does: no order that was given before ends it."""
        self.epochs = Epochs(self.epochs.hold, self._new())

    def _new(self) -> bytes:
        drawn = self._draw(EPOCH_SIZE)
        # Nothing may name it by chance.
        return drawn if drawn != UNKNOWN else self._new()
