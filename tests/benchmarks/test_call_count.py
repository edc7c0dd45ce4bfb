"""The counts of a hop: what is a move, what a return, and that a hop is recorded whole."""

from __future__ import annotations

from pathlib import Path

from hops.call_count import HOPS, Walk, recorded_hops

from lfield import loop


def test_a_return_is_a_move_to_a_file_of_before():
    walk = Walk((("a", "f"), ("a", "g"), ("b", "h"), ("a", "f"), ("c", "k"), ("b", "h")))
    assert (walk.files, walk.moves, walk.returns) == (3, 4, 2)


def test_a_hop_is_recorded_from_the_departure_to_the_portal(tmp_path: Path):
    hops = loop.run(recorded_hops(tmp_path, journals=False))
    assert len(hops) == HOPS
    files = [file for file, _ in hops[0].calls]
    assert files[0] == "vm/outside.py"
    assert {"mobility/departures.py", "net/peers.py", "mobility/arrivals.py"} <= set(files)
