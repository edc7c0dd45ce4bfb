"""The stages of a hop: every tap is on an existing method, and the stages add up."""

from __future__ import annotations

import pytest
from hops.stages import ORDER, TAPS, travel
from hops.taps import ENDS, Stages, Tap, tapping

from lfield import event_loop
from lfield.vm.wasm.engine_selection import has_wasm


@pytest.mark.parametrize("engine", ["reference", "wasm"] if has_wasm() else ["reference"])
def test_every_stage_of_a_hop_is_measured(tmp_path, engine):
    methods = [getattr(tap.owner, tap.name) for tap in TAPS]
    (hop, *_) = hops = event_loop.run(travel(tmp_path, 64, 20, engine))
    assert len(hops) == 20
    assert set(ORDER) <= hop.keys()
    assert all(seconds >= 0.0 for seconds in hop.values())
    assert [getattr(tap.owner, tap.name) for tap in TAPS] == methods


def test_time_of_an_inner_tap_is_not_counted_in_the_outer_one():
    class Host:
        def leave(self):
            self.write()

        def write(self):
            pass

    stages, host = Stages(), Host()
    taps = Tap("leave", Host, "leave", there="arrive"), Tap("write", Host, "write", behind=ENDS)
    with tapping(stages, taps):
        host.leave()
        assert stages.hops == []
        host.leave()
    assert set(stages.hops[0]) == {"", "leave", "write", ENDS, "arrive"}
    host.leave()
    assert len(stages.hops) == 1
