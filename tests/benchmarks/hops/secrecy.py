"""The cost of TLS for a hop: the same hops with and without TLS in turns; both hosts in this process."""

from __future__ import annotations

from collections.abc import Mapping

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.processes import Processes
from harness.samples import Contender
from hops.stages import travel

from lfield import event_loop
from lfield.vm.wasm.engine_selection import has_wasm

#: Bytes of live state in addition to the coordinator.
SIZES = (64, 1 << 10, 8 << 10, 64 << 10)
#: Hops of one round; the two take turns, so that load of the computer affects both.
HOPS = 200


def hops(*, plain: bool) -> Opener:
    """Seconds of hops of each size; each round starts two new hosts."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        return lambda: {_case(size): _wholes(size, plain=plain) for size in SIZES}

    return opener


def _wholes(size: int, *, plain: bool) -> list[float]:
    engine = "wasm" if has_wasm() else "reference"
    with Processes() as processes:
        durations = event_loop.run(travel(processes.folder(), size, HOPS, engine, plain=plain))
    return [_whole(hop) for hop in durations]


def _whole(hop: Mapping[str, float]) -> float:
    return sum(hop.values())


def _case(size: int) -> str:
    return f"{size} B"


FIGURE = Figure(
    "A hop with and without TLS; ratio to the plain one",
    {"plain": hops(plain=True), "TLS 1.3": hops(plain=False)},
    base=("plain",),
    rounds=10,
    sizes={_case(size): size for size in SIZES},
    notes=(
        f"rounds of {HOPS} hops of each in turn, both hosts in one process; without TLS no host listens, so "
        "only here",
    ),
)
