"""The time at which a turn is recorded: after its effects, and without an effect on its host."""

from __future__ import annotations

import pytest
from recorded_teams import compare, recorded, run_recorded, walk_mission

from lfield.host.core import HostCore
from lfield.host.host import Host
from lfield.host.inputs import LinksPlanned
from lfield.host.recording import flight_recorder
from lfield.host.recording.flight_recorder import FlightRecorder
from lfield.host.recording.host_records import FrameBuffer, IdleTurn, TurnRecord
from lfield.host.recording.recording_target import RecordingMemory
from lfield.replication.transfer.effects import SendTransfer
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.text import log_messages


def test_a_turn_is_encoded_after_its_messages_are_sent(tmp_path, monkeypatch) -> None:
    steps: list[tuple[str, float]] = []
    execute, add_turn = Host._execute, FrameBuffer.add_turn

    def executed(host, effect):
        if isinstance(effect, SendTransfer):
            steps.append(("sent", host.core.context.clock.monotonic()))
        execute(host, effect)

    def added(buffer, record):
        steps.append(("recorded", record.at))
        return add_turn(buffer, record)

    monkeypatch.setattr(Host, "_execute", executed)
    monkeypatch.setattr(FrameBuffer, "add_turn", added)
    run_recorded(walk_mission(tmp_path), 2.0)
    sent = [at for step, at in steps if step == "sent"]
    assert len(sent) > 4
    assert all(steps.index(("sent", at)) < steps.index(("recorded", at)) for at in sent)


def test_a_turn_within_the_effects_of_another_is_recorded_after_it(tmp_path, monkeypatch) -> None:
    """As when an effect requests a link, and the link asks the core for its planned links."""
    execute, run, requests = Host._execute, HostCore.run, []

    def executed(host, effect):
        execute(host, effect)
        requests.append(host.apply(LinksPlanned()))

    def run_with_wall_time(core):
        core.context.clock.time()
        return run(core)

    monkeypatch.setattr(Host, "_execute", executed)
    monkeypatch.setattr(HostCore, "run", run_with_wall_time)
    team = run_recorded(walk_mission(tmp_path), 2.0)
    assert len(requests) > 4
    turns = [turn for recording in team.recordings() for _, turn in recording.turns_from(0)]
    planned = [turn for turn in turns if isinstance(turn, TurnRecord) and turn.entry == LinksPlanned()]
    assert len(planned) >= len(requests)
    assert all(turn.wall is not None for turn in turns if not isinstance(turn, IdleTurn) and turn.run)
    assert not compare(team, at_checkpoints=False).differences


@pytest.mark.parametrize("fails", [FrameBuffer.add_turn, FrameBuffer.add])
def test_an_error_of_the_recorder_ends_the_recording_but_not_the_host(fails, tmp_path, monkeypatch) -> None:
    memory = RecordingMemory()
    fleet = Fleet(walk_mission(tmp_path), 1, options=FleetOptions(record=memory))
    fleet.run(2.0)

    def fail(buffer, record):
        raise ValueError("no encoding")

    monkeypatch.setattr(FrameBuffer, fails.__name__, fail)
    for life in fleet.runs.values():
        life.host.note(log_messages.NO_DESCRIPTORS.line(reason="an event of the shell"))
    fleet.run(2.0)
    before = len(fleet.log)
    fleet.run(2.0)
    log = [text for _, host, text in fleet.log if "ValueError: no encoding" in text]
    assert len(log) == len(memory.sinks) == 2
    assert len(fleet.log) > before
    assert all(life.host.failure is None for life in fleet.runs.values())
    assert not compare(recorded(fleet.mission, memory), at_checkpoints=False).differences
    fleet.close()


def test_the_last_turn_is_in_the_recording_if_its_effects_fail(tmp_path, monkeypatch) -> None:
    memory = RecordingMemory()
    fleet = Fleet(walk_mission(tmp_path), 1, options=FleetOptions(record=memory))
    ended: list[float] = []
    failed: list[str] = []
    end_turn = FlightRecorder.end_turn

    def counted(flight, at, *given, **named):
        ended.append(at)
        end_turn(flight, at, *given, **named)

    def fail(host, effect):
        failed.append(host.name)
        raise ZeroDivisionError

    fleet.run(2.0)
    monkeypatch.setattr(FlightRecorder, "end_turn", counted)
    monkeypatch.setattr(Host, "_execute", fail)
    fleet.run(5.0)
    assert failed
    times = {
        turn.at for each in recorded(fleet.mission, memory).recordings() for _, turn in each.turns_from(0)
    }
    assert set(ended) <= times
    fleet.close()


def test_a_large_batch_is_written_at_once(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(flight_recorder, "BATCH_BYTES", 1)
    each_turn = run_recorded(walk_mission(tmp_path), 1.0)
    frames = [len(frames) for _, frames in each_turn.hosts]
    turns = [recording.turns for recording in each_turn.recordings()]
    assert all(count > turn * 0.8 for count, turn in zip(frames, turns, strict=True))
    assert not compare(each_turn, at_checkpoints=False).differences


def test_a_turn_that_fails_is_not_recorded(tmp_path, monkeypatch) -> None:
    """A replay shows the failure itself: the recording ends before it."""
    memory = RecordingMemory()
    fleet = Fleet(walk_mission(tmp_path), 1, options=FleetOptions(record=memory))
    fleet.run(2.0)
    run, failed = HostCore.run, []

    def fail(core):
        failed.append(core.context.clock.monotonic())
        raise ZeroDivisionError

    monkeypatch.setattr(HostCore, "run", fail)
    fleet.run(5.0)
    monkeypatch.setattr(HostCore, "run", run)
    team = recorded(fleet.mission, memory)
    times = {turn.at for each in team.recordings() for _, turn in each.turns_from(0)}
    assert len(failed) == 2
    assert not times & set(failed)
    assert not compare(team, at_checkpoints=False).differences
    fleet.close()
