"""The picture of the rooms in the documents is what the imports say."""

from __future__ import annotations

import rooms


def test_the_picture_is_up_to_date() -> None:
    assert rooms.PAGE.read_text(encoding="utf-8") == rooms.picture(), (
        "run: python tests/tidy/rooms.py --write"
    )


def test_rooms_stand_above_all_that_they_import() -> None:
    known = {"roof": {"wall", "floor"}, "wall": {"floor"}, "floor": set(), "shed": set()}
    arrows = {room: frozenset(others) for room, others in known.items()}
    assert rooms.floors(arrows) == [["floor", "shed"], ["wall"], ["roof"]]
    assert rooms.reduced(arrows)["roof"] == {"wall"}
