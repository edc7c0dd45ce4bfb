"""The counts of a hop: moves and returns, and the complete recording of a hop."""

from __future__ import annotations

from pathlib import Path

import pytest
from hops import hop_diagram
from hops.call_count import FIGURES, HOPS, Walk, device_call, recorded_hops, shortest

from lfield import event_loop


def test_return_is_a_move_to_an_earlier_file():
    walk = Walk((("a", "f"), ("a", "g"), ("b", "h"), ("a", "f"), ("c", "k"), ("b", "h")))
    assert (walk.files, walk.moves, walk.returns) == (3, 4, 2)


def test_hop_is_recorded_from_the_departure_to_the_portal(tmp_path: Path):
    hops = event_loop.run(recorded_hops(tmp_path, journals=False))
    assert len(hops) == HOPS
    files = [file for file, _ in hops[0].calls]
    assert files[0] == "vm/host_calls.py"
    assert {
        "replication/transfer/transfer_sender.py",
        "net/link_manager.py",
        "replication/transfer/transfer_receiver.py",
    } <= set(files)


@pytest.mark.parametrize("journals", ["no", "yes"])
def test_hop_takes_no_more_calls_than_before(journals: str):
    """Lower counts are entered in figures.tsv by hand. Counts over TCP depend on the computer's load."""
    most = FIGURES["simulated", journals]
    walk = shortest(simulated=True, journals=journals == "yes")
    if journals == "no":
        drawn = hop_diagram.PAGE.read_text(encoding="utf-8")
        assert drawn == hop_diagram.diagram(walk), "run: python tests/benchmarks/hops/hop_diagram.py --write"
    assert len(walk.calls) <= most.calls
    assert walk.files <= most.files
    assert walk.returns <= most.returns


def test_recording_events_costs_no_call_without_subscribers():
    walk = shortest(simulated=True, journals=False)
    assert not [file for file, _ in walk.calls if file.startswith("host/events/")]


def test_device_instruction_takes_no_more_calls_than_before(tmp_path: Path):
    most, walk = FIGURES["device", "no"], device_call(tmp_path)
    assert walk.calls[0][0] == "vm/host_calls.py"
    assert "guard/core.py" in {file for file, _ in walk.calls}
    assert len(walk.calls) <= most.calls
    assert walk.files <= most.files
    assert walk.returns <= most.returns


def test_arrow_is_a_public_call_in_another_package():
    walk = Walk(
        (
            ("vm/a.py", "A.f"),
            ("host/b.py", "B._private"),
            ("wire/c.py", "C.f"),
            ("net/d.py", "StreamLink.write_now"),
            ("net/d.py", "StreamLink.received"),
            ("host/b.py", "B.f"),
        )
    )
    assert list(hop_diagram.arrows(walk)) == [
        (0, 3, "StreamLink.write_now"),
        (3, 4, "StreamLink.received"),
        (4, 6, "B.f"),
    ]
