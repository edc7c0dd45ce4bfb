"""What TLS costs a hop: the same hops with it and without, side by side; both hosts in this process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from harness.checkout import Checkout
from harness.figure import Figure, Row
from harness.processes import Processes
from harness.samples import Tick, median
from hops.stages import travel

from lfield import loop
from lfield.vm.wasm.choice import has_wasm

#: Bytes of live state, on top of the coordinator itself.
SIZES = (64, 1 << 10, 8 << 10, 64 << 10)
#: Hops of one turn; the two take turns, so that a busy moment of the computer is both's.
HOPS = 200


def measured(checkout: Checkout, rounds: int, tick: Tick) -> Iterator[Row]:
    """A line for each size and way; the ratio is to the plain one."""
    engine = "wasm" if has_wasm() else "reference"
    for size in SIZES:
        tick(f"{size} B")
        plain: list[float] = []
        secret: list[float] = []
        for _ in range(rounds):
            plain += _wholes(size, engine, plain=True)
            secret += _wholes(size, engine, plain=False)
        yield Row(f"{size} B", "plain", samples=plain)
        yield Row("", "TLS 1.3", samples=secret, ratio=median(secret) / median(plain))


def _wholes(size: int, engine: str, *, plain: bool) -> list[float]:
    with Processes() as processes:
        hops = loop.run(travel(processes.folder(), size, HOPS, engine, plain=plain))
    return [_whole(hop) for hop in hops]


def _whole(hop: Mapping[str, float]) -> float:
    return sum(hop.values())


FIGURE = Figure(
    "A hop with and without TLS; ratio: to the plain one",
    {},
    rounds=10,
    own_rows=measured,
    notes=(
        f"rounds of {HOPS} hops of each in turn, both hosts in one process; without TLS no host listens, so "
        "only here",
    ),
)
