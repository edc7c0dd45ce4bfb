"""The counts of a hop: what is a move, what a return, and that a hop is recorded whole."""

from __future__ import annotations

from pathlib import Path

import pytest
from hops.call_count import FIGURES, HOPS, Walk, recorded_hops, shortest

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


@pytest.mark.parametrize("journals", ["no", "yes"])
def test_a_hop_takes_no_more_calls_than_it_did(journals: str):
    """Lower figures go into the file by hand. Counts over TCP depend on how busy the computer is."""
    most = FIGURES["simulated", journals]
    walk = shortest(simulated=True, journals=journals == "yes")
    assert len(walk.calls) <= most.calls
    assert walk.files <= most.files
    assert walk.returns <= most.returns
