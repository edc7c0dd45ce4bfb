"""Several addresses with one system id: the decision whether they are one vehicle, by packets and times."""

from __future__ import annotations

import pytest

from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.packet_sources import (
    BACKWARDS,
    CONFLICT_TIME,
    LISTEN_TIME,
    MAX_QUERIES,
    MAX_SOURCES,
    Source,
    Sources,
)
from lfield_mavlink.link.sender_separation import Board

A, B = Source(0, "10.0.0.5:14555"), Source(0, "10.0.0.6:14555")
CABLE, RADIO = Source(0), Source(1)
LINKS = ["udpin:0.0.0.0:14550", "serial:/dev/ttyUSB0:57600"]


def beat():
    return dialect.MAVLink_heartbeat_message(2, 3, 129, 4, 4, 3)


def attitude(booted):
    return dialect.MAVLink_attitude_message(round(booted * 1000), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def version(uid=0, uid2=b"", firmware=7):
    long = list(uid2.ljust(18, b"\0"))
    zeros = [0] * 8
    return dialect.MAVLink_autopilot_version_message(
        0, firmware, 0, 0, 0, zeros, zeros, zeros, 0, 0, uid, long
    )


def run(sources, seconds, *senders, start=0.0, every=1.0, boards=None):
    """Send heartbeats of each sender for some seconds; returns whether each was accepted at the end.

    A sender answers a query of its board with its message in `boards`, if there is one.
    """
    believed = {}
    for number in range(round(seconds / every) + 1):
        for offset, sender in enumerate(senders):
            now = start + number * every + 0.01 * offset
            believed[sender] = sources.on_packet(sender, beat(), now)
            for source in sources.due(now):
                if boards and source in boards:
                    believed[source] = sources.on_packet(source, boards[source], now)
    return believed


def test_two_addresses_that_both_send_are_two_vehicles():
    s = Sources(1, LINKS[:1])
    assert run(s, 3.0, A, B) == {A: True, B: False}
    assert s.conflict(3.1) == (
        "two vehicles send as system 1: udpin:0.0.0.0:14550 from 10.0.0.5:14555 and "
        "udpin:0.0.0.0:14550 from 10.0.0.6:14555"
    )
    assert s.is_settled(3.1)
    assert len(s.events) == 1
    assert s.address(0) == A.address
    run(s, 60.0, A, B, start=4.0)
    assert len(s.events) == 1
    # One of them stops: the conflict ends.
    run(s, CONFLICT_TIME + 2.0, A, start=65.0)
    assert s.conflict(65.0 + CONFLICT_TIME + 2.0) == ""


def test_new_address_with_the_same_board_replaces_a_silent_one():
    s = Sources(1, LINKS[:1])
    run(s, 5.0, A)
    s.on_packet(A, SAME, 5.0)
    assert run(s, 1.0, B, start=5.5, boards={B: SAME}) == {B: False}
    assert s.conflict(6.6) == ""
    assert not s.is_settled(6.6)
    assert run(s, 4.0, B, start=7.5, boards={B: SAME}) == {B: True}
    assert (s.moves, s.conflict(12.0), s.is_settled(12.0)) == (1, "", True)
    assert s.events == [
        "address changed to udpin:0.0.0.0:14550 from 10.0.0.6:14555, from "
        "udpin:0.0.0.0:14550 from 10.0.0.5:14555"
    ]
    assert s.address(0) == B.address


def test_late_packets_of_the_old_address_are_no_conflict():
    s = Sources(1, LINKS[:1])
    run(s, 5.0, A)
    assert not s.on_packet(B, beat(), 5.2)
    assert s.on_packet(A, attitude(5.0), 5.5)
    run(s, 8.0, B, start=6.2)
    assert s.events == [s.events[0]]
    assert s.moves == 1


@pytest.mark.parametrize("first", [A, B])
@pytest.mark.parametrize("has_id", [True, False])
def test_another_vehicle_does_not_replace_a_silent_one(first, has_id):
    """The other vehicle sends while the first one does, or only after it; boards have an id or none."""
    s = Sources(1, LINKS[:1])
    own, others = (SAME, version(uid2=b"abd")) if has_id else (version(), version())
    run(s, 5.0, A)
    s.on_packet(A, own, 5.0)
    if first == B or not has_id:
        run(s, 5.0, A, B, start=6.0, boards={B: others})
    assert run(s, 20.0, B, start=12.0, boards={B: others}) == {B: False}
    assert B.address in s.conflict(32.1)
    assert (s.address(0), s.moves) == (A.address, 0)
    # The first vehicle sends again, and is kept.
    assert run(s, 5.0, A, B, start=33.0) == {A: True, B: False}
    run(s, 20.0, A, start=40.0)
    assert s.conflict(60.1) == ""


def test_address_reported_as_second_vehicle_is_accepted_by_its_board():
    s = Sources(1, LINKS[:1])
    run(s, 5.0, A)
    s.on_packet(A, SAME, 5.0)
    # Packets of the old address are in transit for a long time.
    run(s, 3.0, B, start=5.5)
    s.on_packet(A, attitude(9.0), 8.4)
    s.on_packet(B, beat(), 8.5)
    assert s.conflict(8.6) != ""
    assert run(s, 5.0, B, start=11.5, boards={B: SAME}) == {B: True}
    assert (s.conflict(17.0), s.address(0)) == ("", B.address)


def test_restarted_vehicle_at_another_address_is_accepted():
    s = Sources(1, LINKS[:1])
    run(s, 5.0, A)
    for source, board, clock, now in ((A, SAME, 500.0, 5.0), (B, SAME, 1.0, 9.0)):
        s.on_packet(source, beat(), now)
        s.on_packet(source, attitude(clock), now)
        s.on_packet(source, board, now)
    assert s.address(0) == B.address


def test_sender_without_heartbeat_is_not_accepted():
    s = Sources(1, LINKS[:1])
    assert not s.on_packet(A, attitude(1.0), 0.0)
    assert s.on_packet(A, beat(), 0.1)
    assert s.on_packet(A, attitude(1.2), 0.2)


def test_address_is_settled_after_the_listening_time():
    s = Sources(1, LINKS[:1])
    s.on_packet(A, beat(), 0.0)
    assert not s.is_settled(LISTEN_TIME - 0.01)
    assert s.is_settled(LISTEN_TIME)
    # A link with one remote end has no second address.
    one = Sources(1, ["tcp:127.0.0.1:5760"])
    one.on_packet(CABLE, beat(), 0.0)
    assert one.is_settled(0.0)


def two_links(first, second, clocks=(None, None)):
    """A vehicle on two links, with this AUTOPILOT_VERSION and clock on each."""
    s = Sources(1, LINKS)
    request_count = 0
    for number in range(20):
        now = 0.5 * number
        for source, message, clock in ((CABLE, first, clocks[0]), (RADIO, second, clocks[1])):
            s.on_packet(source, beat(), now)
            if clock is not None:
                s.on_packet(source, attitude(now + clock), now)
            if number == 2 and message is not None:
                s.on_packet(source, message, now)
        request_count += len(s.due(now))
    return s, request_count


SAME = version(uid2=b"abc")


def test_same_board_over_two_links_is_one_vehicle():
    s, x = two_links(SAME, SAME)
    assert s.accepts(CABLE)
    assert s.accepts(RADIO)
    assert (s.conflict(9.6), s.is_settled(9.6)) == ("", True)
    assert 0 < x <= MAX_QUERIES


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (SAME, version(uid2=b"abd")),
        (version(uid=5, uid2=b"\2"), version(uid=5, uid2=b"\3")),
        (version(uid=5), version(uid=6)),
        (version(), version(uid=6)),
        (version(firmware=7), version(firmware=8)),
    ],
)
def test_different_boards_over_two_links_are_two_vehicles(first, second):
    s, _ = two_links(first, second)
    assert s.accepts(CABLE)
    assert not s.accepts(RADIO)
    assert s.conflict(9.6) == (
        "two vehicles send as system 1: udpin:0.0.0.0:14550 and serial:/dev/ttyUSB0:57600"
    )


def test_simulators_with_one_board_id_are_distinguished_by_clock():
    for clock, same in ((100.0, True), (104.0, True), (130.0, False), (None, True)):
        s, _ = two_links(SAME, SAME, (100.0, clock))
        assert s.accepts(RADIO) is same


@pytest.mark.parametrize("board", [version(), None])
@pytest.mark.parametrize(("clock", "same"), [(100.0, True), (101.0, True), (140.0, False), (None, True)])
def test_boards_without_an_id_are_distinguished_by_clock(board, clock, same):
    s, _ = two_links(board, board, (100.0, clock))
    assert s.accepts(RADIO) is same
    assert bool(s.conflict(9.6)) is not same


def test_vehicle_is_kept_on_one_link_when_the_other_is_silent():
    s, _ = two_links(SAME, SAME)
    assert run(s, 10.0, RADIO, start=10.0) == {RADIO: True}
    # Its port has changed: over that link the old address is silent, so it has moved.
    moved = Source(0, "10.0.0.9:1")
    run(s, 3.0, RADIO, moved, start=21.0)
    assert s.due(24.5) == [moved]
    s.on_packet(moved, SAME, 24.6)
    assert s.on_packet(moved, beat(), 25.0)
    assert s.address(0) == moved.address


def test_two_vehicles_behind_one_address_are_detected_by_clock():
    s = Sources(1, ["tcp:127.0.0.1:5760"])
    s.on_packet(CABLE, beat(), 0.0)
    for number in range(BACKWARDS + 1):
        s.on_packet(CABLE, attitude(100.0 + number), 0.1 + number)
        s.on_packet(CABLE, attitude(20.0 + number), 0.2 + number)
    assert s.conflict(4.0) == "two vehicles send as system 1, both over tcp:127.0.0.1:5760"
    assert s.conflict(10.0) == ""


def test_two_vehicles_behind_one_address_are_detected_by_board():
    s = Sources(1, ["udp:127.0.0.1:14550"])
    s.on_packet(CABLE, beat(), 0.0)
    for now, board in ((1.0, SAME), (1.1, version(uid2=b"abd")), (1.3, SAME)):
        assert s.conflict(now) == ""
        assert s.on_packet(CABLE, board, now)
    assert s.conflict(1.3) == "two vehicles send as system 1, both over udp:127.0.0.1:14550"
    assert len(s.events) == 1
    s.on_packet(CABLE, beat(), 10.0)
    assert s.conflict(10.0) == ""


def test_vehicle_that_replaces_another_is_no_conflict():
    s = Sources(1, ["udp:127.0.0.1:14550"])
    s.on_packet(CABLE, beat(), 0.0)
    for now, board in ((1.0, SAME), (1.2, version(uid2=b"abd")), (1.4, version(uid2=b"abd")), (4.4, SAME)):
        s.on_packet(CABLE, board, now)
        assert s.conflict(now) == ""


def test_restart_and_reordered_packets_are_no_second_vehicle():
    s = Sources(1, ["tcp:127.0.0.1:5760"])
    s.on_packet(CABLE, beat(), 0.0)
    for now in range(20):
        s.on_packet(CABLE, attitude(50.0 + now if now < 5 else now - 5.0), float(now))
        s.on_packet(CABLE, attitude(max(50.0 + now if now < 5 else now - 5.5, 0.0)), float(now))
        assert s.conflict(float(now)) == ""


def test_any_number_of_addresses_uses_bounded_memory():
    s = Sources(1, LINKS[:1])
    run(s, 1.0, A)
    for number in range(10 * MAX_SOURCES):
        s.on_packet(Source(0, f"10.1.0.{number}:1"), beat(), 2.0)
        s.on_packet(A, beat(), 2.0)
    assert len(s._states) <= MAX_SOURCES + 1
    assert len(s._conflicting) <= MAX_SOURCES + 1
    assert s.accepts(A)


def test_board_is_identified_by_uid_and_firmware():
    assert Board.from_message(version()).uid == ""
    assert Board.from_message(version(uid=0x3F)).uid == "-3f"
    assert Board.from_message(version(uid2=b"\2", uid=0x3F)).uid == "02-3f"
    assert Board.from_message(version(firmware=1)) != Board.from_message(version(firmware=2))


def numbered(message, number):
    """A message with the number of its packet."""
    writer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    writer.seq = number % 256
    message.pack(writer)
    return message


@pytest.mark.parametrize("gap", [3, 100, 250])
def test_packets_of_two_vehicles_behind_one_address_are_separated(gap):
    """By clock, or by packet number for a message without a time; each sends 50 packets per second."""
    s = Sources(1, ["udp:127.0.0.1:14550"])
    believed = {True: [], False: []}
    for step in range(500):
        now = 0.02 * step
        for first in (True, False) if step > 50 else (True,):
            number, booted = (step, 100.0 + now) if first else (step + gap, 7.0 + now)
            message = attitude(booted) if step % 5 == 0 else beat()
            accepted = s.on_packet(CABLE, numbered(message, number), now + 0.005 * (not first))
            if step > 60:
                believed[first].append(accepted)
    assert all(believed[True])
    assert not any(believed[False])
    assert len(s.events) == 1


def test_restart_is_no_second_vehicle_behind_the_address():
    s = Sources(1, ["udp:127.0.0.1:14550"])
    for step in range(200):
        now = 0.05 * step if step < 100 else 0.05 * step + 1.5
        booted = 50.0 + now if step < 100 else now - 6.0
        message = attitude(booted) if step % 2 else beat()
        assert s.on_packet(CABLE, numbered(message, step if step < 100 else step - 100), now)
    assert s.events == []
