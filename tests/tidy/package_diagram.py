"""Draws the packages of lfield from its imports: `python tests/tidy/package_diagram.py --write` updates the
diagram in the docs.

A package of lfield or a plugin is in the layer above everything that it imports, types included. Implied
arrows are omitted (transitive reduction), and so are arrows to the lowest layer. No position is set
by hand; a test compares the result with the file in the docs.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from html import escape
from pathlib import Path

import grimp

PAGE = Path(__file__).parents[2] / "lfield" / "docs" / "packages.svg"
PLUGINS = ("lfield_can", "lfield_dynamixel", "lfield_mavlink", "lfield_sim")
#: Entry modules: not drawn.
ENTRY_POINTS = ("__main__",)

PackageImports = Mapping[str, frozenset[str]]

WIDTH, BOX, HEIGHT, GAP, LAYER = 1120, 128, 34, 14, 84


def imports_by_package() -> PackageImports:
    """For each package the packages that it imports."""
    graph = grimp.build_graph("lfield", *PLUGINS, exclude_type_checking_imports=False)
    packages = {module.partition(".")[2] for module in graph.find_children("lfield")} - set(ENTRY_POINTS)
    found: dict[str, set[str]] = {package: set() for package in (*packages, *PLUGINS)}
    for importer in graph.modules:
        for imported in graph.find_modules_directly_imported_by(importer):
            near, far = package_of(importer), package_of(imported)
            if near != far and near in found and far in found:
                found[near].add(far)
    return {package: frozenset(known) for package, known in found.items()}


def package_of(module: str) -> str:
    """`lfield.vm.machine` -> `vm`, `lfield_can.bus` -> `lfield_can`."""
    first, _, rest = module.partition(".")
    return rest.partition(".")[0] if first == "lfield" else first


def layers(known: PackageImports) -> list[list[str]]:
    """The packages from the lowest layer up: each above all that it imports."""
    height: dict[str, int] = {}

    def of(package: str) -> int:
        if package not in height:
            height[package] = max((of(other) + 1 for other in known[package]), default=0)
        return height[package]

    top = max(of(package) for package in known)
    return [sorted(package for package in known if of(package) == layer) for layer in range(top + 1)]


def reduced(known: PackageImports) -> PackageImports:
    """The transitive reduction."""
    reach: dict[str, frozenset[str]] = {}

    def of(package: str) -> frozenset[str]:
        if package not in reach:
            reach[package] = known[package].union(*(of(other) for other in known[package]))
        return reach[package]

    return {
        package: frozenset(
            far for far in others if not any(far in of(other) for other in others if other != far)
        )
        for package, others in known.items()
    }


def picture() -> str:
    """The diagram as SVG."""
    known = imports_by_package()
    rows = layers(known)
    drawn = {package: others - set(rows[0]) for package, others in reduced(known).items()}
    tall = LAYER * len(rows) + 20
    places: dict[str, tuple[float, float]] = {}
    for layer, row in enumerate(rows):
        for n, package in enumerate(sorted(row, key=lambda package: position_in_row(package, drawn, places))):
            x = WIDTH / 2 + (n - (len(row) - 1) / 2) * (BOX + GAP)
            places[package] = x, tall - LAYER * (layer + 1) + 20
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {tall}" '
        'font-family="sans-serif" font-size="14">',
        f'<rect width="{WIDTH}" height="{tall}" fill="#ffffff"/>',
    ]
    for near, others in sorted(drawn.items()):
        lines += [arrow(places[near], places[far]) for far in sorted(others)]
    for package, place in places.items():
        lines += package_box(package, place)
    return "\n".join([*lines, "</svg>", ""])


def position_in_row(
    package: str, drawn: PackageImports, places: Mapping[str, tuple[float, float]]
) -> tuple[bool, float, str]:
    """The position of a package in its row: above its imports; plugins last."""
    below = [places[other][0] for other in drawn[package]]
    return package in PLUGINS, sum(below) / len(below) if below else WIDTH / 2, package


def arrow(near: tuple[float, float], far: tuple[float, float]) -> str:
    """From the lower edge of one box to the upper edge of another below it."""
    (x, y), (u, v) = (near[0], near[1] + HEIGHT), far
    bend = (v - y) / 2
    return (
        f'<path d="M{x:g} {y:g} C{x:g} {y + bend:g} {u:g} {v - bend:g} {u:g} {v:g}" '
        'fill="none" stroke="#9aa7b5" stroke-width="1.2"/>'
    )


def package_box(package: str, place: tuple[float, float]) -> list[str]:
    """A package with its name."""
    x, y = place
    fill = "#fff3dd" if package in PLUGINS else "#e4eef8"
    return [
        f'<rect x="{x - BOX / 2:g}" y="{y:g}" width="{BOX}" height="{HEIGHT}" rx="5" '
        f'fill="{fill}" stroke="#4a6076"/>',
        f'<text x="{x:g}" y="{y + 22:g}" text-anchor="middle" fill="#1c2733">{escape(package)}</text>',
    ]


def main() -> None:
    """Print the diagram, or write it into the docs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    if parser.parse_args().write:
        PAGE.write_text(picture(), encoding="utf-8")
    else:
        print(picture())


if __name__ == "__main__":
    main()
