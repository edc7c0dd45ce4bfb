"""The diagram of packages in the documents agrees with the imports."""

from __future__ import annotations

import package_diagram


def test_package_diagram_is_current() -> None:
    assert package_diagram.PAGE.read_text(encoding="utf-8") == package_diagram.picture(), (
        "run: python tests/tidy/package_diagram.py --write"
    )


def test_packages_are_above_their_imports() -> None:
    known = {"roof": {"wall", "floor"}, "wall": {"floor"}, "floor": set(), "shed": set()}
    arrows = {package: frozenset(others) for package, others in known.items()}
    assert package_diagram.layers(arrows) == [["floor", "shed"], ["wall"], ["roof"]]
    assert package_diagram.reduced(arrows)["roof"] == {"wall"}
