"""Snapshots of cores: a written value can be restored, and any other value is refused when it is written."""

from __future__ import annotations

from array import array
from collections import Counter, OrderedDict, defaultdict, deque
from dataclasses import dataclass
from enum import Flag
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from recorded_teams import checkpoint_turns, run_recorded

from lfield.errors import DeviceError, RecordingError
from lfield.host.events.event_rate_limit import RateLimit
from lfield.host.recording import core_snapshot, flight_recorder
from lfield.host.recording.core_snapshot import CoreSnapshots
from lfield.host.recording.object_graph import GraphReader, GraphWriter, walk
from lfield.host.recording.recorded_environment import Question
from lfield.mission.loader import load_mission
from lfield.replay.host_replay import HostReplay
from lfield.text import log_messages
from lfield.vm.memory.block import Block, ThreadPlaces
from lfield.vm.memory.block_allocator import HeapAllocator
from lfield.vm.turns.run_limit import RunLimit

#: More hops, portal calls and lines than a host reports, and calls that fail.
BUSY_PROGRAM = """
resource Post {
    int seen;
    init(string[] arg) { seen = 0; }
    portal stamp(string who) emit int {
        seen = seen + 1;
        if (seen % 50 == 0) throw new Exception("full");
        return seen;
    }
}
coordinator Walker {
    init(string[] arg) {
        Post[] all = findPost();
        int number = 0;
        while (number < 1000000) {
            try { number = number + all[number % all.length()].stamp("walker"); } catch (Exception e) {
                number = number + 1;
                print(e.message());
            }
            int i = 0;
            while (i < 20) { print(i2s(i)); i = i + 1; }
        }
    }
}
"""
#: Racing futures, and threads that wait in monitors, with a limit, without a limit, and for a clock.
WAITING_PROGRAM = """
resource Post {
    int seen;
    init(string[] arg) { seen = 0; }
    portal synchronized next(int after) emit int { wait until (seen > after) within (0.7); return seen; }
    portal synchronized later(real at) emit int { wait until (now() >= at); return seen; }
    portal synchronized put() { seen = seen + 1; }
    portal synchronized ever() emit int { wait until (seen < 0); return seen; }
}
coordinator Walker {
    init(string[] arg) {
        Post[] all = findPost();
        future<int> kept = async all[0].ever();
        while (!kept.done()) {
            future<int>[] calls = {async all[0].next(1000000), async all[1].later(now() + 0.3)};
            calls.append(async all[1].next(0));
            try { print(calls.race()); } catch (Exception e) { print(e.message()); }
            all[0].put();
        }
    }
}
"""
DEPLOYMENT = "//Post:north@north\n//Post:south@south\n//Walker:one@north\n//Walker:two@south\n"


class Colour(Flag):
    RED = 1
    BLUE = 2


def copy_of(value: object) -> Any:
    """The value that a snapshot restores."""
    writer = GraphWriter({}, lambda reading: -1)
    encoded = writer.encode(value)
    reader = GraphReader(lambda reference: None, [], HeapAllocator())
    reader.create(writer.objects())
    return reader.decode(encoded)


@pytest.mark.parametrize(
    "value",
    [
        Counter(a=2, b=1),
        OrderedDict(b=1, a=2),
        {"b": [1, 2.5, None], (1, "x"): {1, 2}},
        defaultdict(list, {"a": [1]}),
        deque([1, 2]),
        frozenset({1, 2}),
        bytearray(b"ab"),
        array("q", [1, -1]),
        RateLimit(1.0, 2.0),
        RunLimit,
        Question.LAST,
        -(1 << 63),
        (1 << 64) - 1,
        log_messages.LINK_LOST.line(host="north"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_value_is_restored_with_its_class(value: Any) -> None:
    found = copy_of(value)
    assert type(found) is type(value)
    assert found == value
    assert getattr(found, "default_factory", None) is getattr(value, "default_factory", None)
    if isinstance(value, OrderedDict):
        found.move_to_end("b")
        assert list(found) == ["a", "b"]


def test_a_log_line_and_an_error_are_restored_with_their_fields() -> None:
    line = copy_of(log_messages.LINK_LOST.line(host="north"))
    assert (line.code, line.template_values) == ("link-lost", {"host": "north"})
    error = copy_of(DeviceError("fc", "no battery", kind="DeviceTimeoutException"))
    assert isinstance(error, DeviceError)
    assert (error.device, error.reason, error.kind) == ("fc", "no battery", "DeviceTimeoutException")
    assert str(error) == "fc: no battery"


def local_object() -> object:
    @dataclass
    class Local:
        number: int = 1

    Local.__module__ = "lfield.host.core"
    return Local()


@pytest.mark.parametrize(
    "value",
    [
        defaultdict(int),
        deque([1], maxlen=2),
        ThreadPlaces(),
        local_object(),
        int,
        partial(RunLimit, now=float),
        count(0, 2),
        Colour.RED | Colour.BLUE,
        1 << 64,
        -(1 << 63) - 1,
        lambda: 1,
        print,
        [].append,
        Path("x"),
        1j,
        OSError("x"),
    ],
)
def test_a_value_that_cannot_be_restored_is_refused_when_it_is_written(value: object) -> None:
    with pytest.raises(RecordingError):
        copy_of(value)


def classes_in(core: object, known: dict[int, Any]) -> Counter[type]:
    """The classes of the objects of a core that have a state in a snapshot; a block has caches of its own."""
    found = walk(core, known, (*core_snapshot._STATELESS, Block))
    return Counter(type(each) for each in found)


@pytest.mark.few(1)
@pytest.mark.parametrize("program", [BUSY_PROGRAM, WAITING_PROGRAM], ids=["busy", "waiting"])
def test_every_object_of_a_core_is_restored_with_its_class(program: str, tmp_path, monkeypatch) -> None:
    (tmp_path / "mission.L").write_text(program)
    (tmp_path / "mission.dL").write_text(DEPLOYMENT)
    monkeypatch.setattr(flight_recorder, "CHECKPOINT_INTERVAL", 0.25)
    written: dict[bytes, Counter[type]] = {}
    capture = CoreSnapshots.capture

    def noted(self: CoreSnapshots) -> bytes:
        data = capture(self)
        externals = {id(each): 0 for each in core_snapshot._externals(self._core).values()}
        written[data] = classes_in(self._core, externals)
        return data

    monkeypatch.setattr(CoreSnapshots, "capture", noted)
    team = run_recorded(load_mission(tmp_path / "mission.dL"), 4.0)
    restored = 0
    for recording in team.recordings():
        for following in checkpoint_turns(recording):
            turn, checkpoint = recording.checkpoint_before(following)
            replay = HostReplay(recording, team.mission, turn=turn, checkpoint=checkpoint)
            externals = {id(each): 0 for each in core_snapshot._externals(replay.core).values()}
            assert classes_in(replay.core, externals) == written[checkpoint.snapshot]
            restored += 1
    assert restored > 10
    assert any(Counter in each for each in written.values())
