"""Draws the sequence diagram of a hop from its calls: `python tests/benchmarks/hops/hop_diagram.py --write`.

`call_count` records the calls in a simulated team without journals, where all runs are equal. An arrow is a
call of a public function in another package than the previous call. A test compares the result with the
file in the docs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(Path(__file__).parents[1]))

from hops.call_count import Walk, shortest  # noqa: E402

PAGE = ROOT / "lfield" / "docs" / "hop-sequence.svg"
#: The lifelines of each host, from the outside to the wire between them.
PACKAGES = ("vm", "host", "replication", "net")
#: The last function on the host of departure: later calls run on the other host.
WRITE = "StreamLink.write_now"

COLUMN, ROW, TOP, MARGIN = 150, 20, 66, 90


class Arrow(NamedTuple):
    """A call from one lifeline to another; `label` is the function that was called."""

    near: int
    far: int
    label: str


def arrows(walk: Walk) -> Iterator[Arrow]:
    """The calls between lifelines in order, without private functions and other packages."""
    lifeline, is_remote = 0, False
    for file, function in walk.calls:
        package = file.partition("/")[0]
        if package in PACKAGES:
            column = PACKAGES.index(package)
            column = 2 * len(PACKAGES) - 1 - column if is_remote else column
            is_public = "<" not in function and not any(part.startswith("_") for part in function.split("."))
            if column != lifeline and is_public:
                yield Arrow(lifeline, column, function)
                lifeline = column
        is_remote = is_remote or function == WRITE


def diagram(walk: Walk) -> str:
    """The diagram as SVG."""
    drawn = list(arrows(walk))
    tall, wide = TOP + ROW * (len(drawn) + 1), 2 * MARGIN + COLUMN * (2 * len(PACKAGES) - 1)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {tall}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{wide}" height="{tall}" fill="#ffffff"/>',
    ]
    middle = MARGIN + COLUMN * (len(PACKAGES) - 0.5)
    for host, x in (("sending host", middle / 2), ("receiving host", (wide + middle) / 2)):
        lines.append(f'<text x="{x:g}" y="20" text-anchor="middle" font-weight="bold">{host}</text>')
    lines.append(f'<path d="M{middle:g} 8 V{tall}" stroke="#9aa7b5" stroke-dasharray="5 4"/>')
    for column, package in enumerate((*PACKAGES, *reversed(PACKAGES))):
        x = MARGIN + COLUMN * column
        lines.append(f'<text x="{x:g}" y="46" text-anchor="middle" fill="#1c2733">{package}</text>')
        lines.append(f'<path d="M{x:g} 52 V{tall}" stroke="#c9d3dd"/>')
    for row, arrow in enumerate(drawn):
        lines += arrow_lines(arrow, TOP + ROW * (row + 0.5))
    return "\n".join([*lines, "</svg>", ""])


def arrow_lines(arrow: Arrow, y: float) -> list[str]:
    """An arrow with the name of the function above it."""
    near, far = MARGIN + COLUMN * arrow.near, MARGIN + COLUMN * arrow.far
    tip = far - 6 if far > near else far + 6
    middle = (near + far) / 2
    return [
        f'<path d="M{near:g} {y:g} H{far:g} M{tip:g} {y - 3:g} L{far:g} {y:g} L{tip:g} {y + 3:g}" '
        'fill="none" stroke="#4a6076"/>',
        f'<text x="{middle:g}" y="{y - 3:g}" text-anchor="middle">{escape(arrow.label)}</text>',
    ]


def main() -> None:
    """Print the diagram, or write it into the docs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    drawn = diagram(shortest(simulated=True, journals=False))
    if parser.parse_args().write:
        PAGE.write_text(drawn, encoding="utf-8")
    else:
        print(drawn)


if __name__ == "__main__":
    main()
