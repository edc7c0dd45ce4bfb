"""The memory of a host without devices: resident size, and with shared pages divided (PSS)."""

from __future__ import annotations

from collections.abc import Sequence

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import BYTES
from harness.paced import Round
from harness.processes import Processes
from machine.small import settled, small_host

_KINDS = {"resident": "Rss:", "proportional": "Pss:"}


def memory(checkout: Checkout, words: Sequence[str]) -> Round:
    """Bytes of one host."""
    with Processes() as processes:
        rollup = (settled(checkout, processes, words) / "smaps_rollup").read_text(encoding="ascii")
    kilobytes = {line.split()[0]: int(line.split()[1]) for line in rollup.splitlines() if line.endswith("kB")}
    return {kind: [kilobytes[field] * 1024.0] for kind, field in _KINDS.items()}


def _hosts() -> dict[str, Opener]:
    return {
        f"from {source}, {engine}": small_host(memory, compiled=compiled, engine=engine)
        for engine in sorted(Checkout.own().engines)
        for compiled, source in ((False, "L text"), (True, "a program file"))
    }


FIGURE = Figure(
    "The memory of a host without devices",
    _hosts(),
    rounds=3,
    units=dict.fromkeys(_KINDS, BYTES),
    one_size="one host with one small program",
    targets={"resident": "55.0 MB"},
    between=tuple(_hosts()),
)
