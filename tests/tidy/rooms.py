"""Draws the rooms of lfield from its imports: `python tests/tidy/rooms.py --write` renews it in the docs.

A room is a package of lfield, or a plugin. It stands on the floor above everything that it imports, types
included. Of the arrows only those are drawn that do not follow from others, and none to the ground floor,
whose words everybody speaks. Nothing here is set by hand, so the picture cannot lie; a test compares it with
the one in the documents.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from html import escape
from pathlib import Path

import grimp

PAGE = Path(__file__).parents[2] / "lfield" / "docs" / "rooms.svg"
PLUGINS = ("lfield_can", "lfield_dynamixel", "lfield_mavlink", "lfield_sim")
#: What starts everything and is no room.
DOORS = ("__main__",)

Arrows = Mapping[str, frozenset[str]]

WIDTH, BOX, HEIGHT, GAP, FLOOR = 1120, 128, 34, 14, 84


def arrows() -> Arrows:
    """For each room the rooms that it imports."""
    graph = grimp.build_graph("lfield", *PLUGINS, exclude_type_checking_imports=False)
    rooms = {module.partition(".")[2] for module in graph.find_children("lfield")} - set(DOORS)
    found: dict[str, set[str]] = {room: set() for room in (*rooms, *PLUGINS)}
    for importer in graph.modules:
        for imported in graph.find_modules_directly_imported_by(importer):
            near, far = room_of(importer), room_of(imported)
            if near != far and near in found and far in found:
                found[near].add(far)
    return {room: frozenset(known) for room, known in found.items()}


def room_of(module: str) -> str:
    """`lfield.vm.machine` -> `vm`, `lfield_can.bus` -> `lfield_can`."""
    first, _, rest = module.partition(".")
    return rest.partition(".")[0] if first == "lfield" else first


def floors(known: Arrows) -> list[list[str]]:
    """The rooms from the ground up: each above all that it imports."""
    height: dict[str, int] = {}

    def of(room: str) -> int:
        if room not in height:
            height[room] = max((of(other) + 1 for other in known[room]), default=0)
        return height[room]

    top = max(of(room) for room in known)
    return [sorted(room for room in known if of(room) == floor) for floor in range(top + 1)]


def reduced(known: Arrows) -> Arrows:
    """Without the arrows that follow from others."""
    reach: dict[str, frozenset[str]] = {}

    def of(room: str) -> frozenset[str]:
        if room not in reach:
            reach[room] = known[room].union(*(of(other) for other in known[room]))
        return reach[room]

    return {
        room: frozenset(
            far for far in others if not any(far in of(other) for other in others if other != far)
        )
        for room, others in known.items()
    }


def picture() -> str:
    """The picture as SVG."""
    known = arrows()
    rows = floors(known)
    drawn = {room: others - set(rows[0]) for room, others in reduced(known).items()}
    tall = FLOOR * len(rows) + 20
    places: dict[str, tuple[float, float]] = {}
    for floor, row in enumerate(rows):
        for n, room in enumerate(sorted(row, key=lambda room: beside(room, drawn, places))):
            x = WIDTH / 2 + (n - (len(row) - 1) / 2) * (BOX + GAP)
            places[room] = x, tall - FLOOR * (floor + 1) + 20
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {tall}" '
        'font-family="sans-serif" font-size="14">',
        f'<rect width="{WIDTH}" height="{tall}" fill="#ffffff"/>',
    ]
    for near, others in sorted(drawn.items()):
        lines += [arrow(places[near], places[far]) for far in sorted(others)]
    for room, place in places.items():
        lines += box(room, place)
    return "\n".join([*lines, "</svg>", ""])


def beside(room: str, drawn: Arrows, places: Mapping[str, tuple[float, float]]) -> tuple[bool, float, str]:
    """Where in its row a room stands: above what it leads to; plugins at the end."""
    below = [places[other][0] for other in drawn[room]]
    return room in PLUGINS, sum(below) / len(below) if below else WIDTH / 2, room


def arrow(near: tuple[float, float], far: tuple[float, float]) -> str:
    """From the foot of one box to the head of another below it."""
    (x, y), (u, v) = (near[0], near[1] + HEIGHT), far
    bend = (v - y) / 2
    return (
        f'<path d="M{x:g} {y:g} C{x:g} {y + bend:g} {u:g} {v - bend:g} {u:g} {v:g}" '
        'fill="none" stroke="#9aa7b5" stroke-width="1.2"/>'
    )


def box(room: str, place: tuple[float, float]) -> list[str]:
    """A room with its name."""
    x, y = place
    fill = "#fff3dd" if room in PLUGINS else "#e4eef8"
    return [
        f'<rect x="{x - BOX / 2:g}" y="{y:g}" width="{BOX}" height="{HEIGHT}" rx="5" '
        f'fill="{fill}" stroke="#4a6076"/>',
        f'<text x="{x:g}" y="{y + 22:g}" text-anchor="middle" fill="#1c2733">{escape(room)}</text>',
    ]


def main() -> None:
    """Print the picture, or write it into its place."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    if parser.parse_args().write:
        PAGE.write_text(picture(), encoding="utf-8")
    else:
        print(picture())


if __name__ == "__main__":
    main()
