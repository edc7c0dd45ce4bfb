"""Message signing of the fake against pymavlink's own: who is heard, and that the answers are signed."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from lfield_sim.mavlink.link.signing import MAX_STREAMS, PER_SECOND, MessageSigning

KEY, OTHER = bytes(range(32)), bytes(32 * [7])
#: 2026, in units of 10 us since 2015.
NOW = 11 * 365 * 86_400 * PER_SECOND


class Vehicle:
    """A signing vehicle and its clock."""

    def __init__(self, key=KEY):
        self.now = 0.0
        self.gate = MessageSigning(1, lambda: self.now)
        if key:
            assert self.hears(station(None).setup(key))

    def hears(self, packet, *, local=False):
        (message,) = dialect.MAVLink(None).parse_buffer(packet)
        return self.gate.admits(message, local=local)

    def says(self):
        packer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self.gate.seal(packer)
        return bytes(dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(packer))


class station:
    """A client of pymavlink that signs when it has a key."""

    def __init__(self, key, *, link=1, timestamp=NOW, component=190):
        self.mav = dialect.MAVLink(None, srcSystem=255, srcComponent=component)
        self.mav.robust_parsing = True
        signing = self.mav.signing
        signing.secret_key, signing.sign_outgoing = key, key is not None
        signing.link_id, signing.timestamp = link, timestamp

    def beat(self):
        return bytes(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(self.mav))

    def setup(self, key, target=1, timestamp=NOW):
        return bytes(dialect.MAVLink_setup_signing_message(target, 1, key, timestamp).pack(self.mav))


def test_without_a_key_everybody_is_heard_and_nothing_signed():
    vehicle = Vehicle(key=None)
    assert vehicle.hears(station(None).beat())
    assert vehicle.hears(station(OTHER).beat())
    assert not vehicle.says()[2] & dialect.MAVLINK_IFLAG_SIGNED


def test_unsigned_is_ignored_but_on_the_serial_door():
    vehicle = Vehicle()
    assert not vehicle.hears(station(None).beat())
    assert vehicle.hears(station(None).beat(), local=True)


def test_the_right_key_is_heard_and_the_wrong_one_is_not():
    vehicle = Vehicle()
    assert vehicle.hears(station(KEY).beat())
    assert not vehicle.hears(station(OTHER, link=2).beat())


def test_answers_are_signed_with_rising_timestamps():
    vehicle, client = Vehicle(), station(KEY)
    heard = [client.mav.parse_buffer(vehicle.says()) for _ in range(3)]
    assert [m.get_type() for (m,) in heard] == ["HEARTBEAT"] * 3
    assert (client.mav.signing.goodsig_count, client.mav.signing.badsig_count) == (3, 0)
    stranger = station(OTHER)
    assert [m.get_type() for m in stranger.mav.parse_buffer(vehicle.says())] == ["BAD_DATA"]
    assert stranger.mav.signing.badsig_count == 1


def test_a_replay_is_ignored():
    vehicle, client = Vehicle(), station(KEY)
    packet = client.beat()
    assert vehicle.hears(packet)
    assert not vehicle.hears(packet)
    assert vehicle.hears(client.beat())


@pytest.mark.parametrize(("behind", "heard"), [(59, True), (61, False), (11 * 365 * 86_400, False)])
def test_an_old_timestamp_is_ignored(behind, heard):
    vehicle = Vehicle()
    assert vehicle.hears(station(KEY, timestamp=NOW - behind * PER_SECOND).beat()) is heard


def test_time_goes_on_with_the_vehicle():
    vehicle = Vehicle()
    vehicle.now = 100.0
    assert not vehicle.hears(station(KEY, timestamp=NOW + 39 * PER_SECOND).beat())
    assert vehicle.hears(station(KEY, timestamp=NOW + 41 * PER_SECOND).beat())


def test_a_timestamp_from_the_future_moves_the_vehicle_on():
    vehicle = Vehicle()
    assert vehicle.hears(station(KEY, timestamp=NOW + 1000 * PER_SECOND).beat())
    assert not vehicle.hears(station(KEY, link=2).beat()), "a new stream is more than a minute behind now"


def test_the_key_is_changed_by_who_has_it():
    vehicle = Vehicle()
    assert not vehicle.hears(station(None).setup(OTHER))
    assert not vehicle.hears(station(OTHER).setup(OTHER))
    assert vehicle.gate.key == KEY
    assert vehicle.hears(station(KEY).setup(OTHER, target=9))
    assert vehicle.gate.key == KEY, "that was for another system"
    assert vehicle.hears(station(KEY, link=2).setup(OTHER))
    assert vehicle.gate.key == OTHER
    assert vehicle.hears(station(None).setup(bytes(32)), local=True)
    assert vehicle.gate.key is None, "a key of zeros switches it off"


def test_the_greatest_timestamp_does_not_break_it():
    vehicle = Vehicle(key=None)
    vehicle.hears(station(None).setup(KEY, timestamp=(1 << 64) - 1))
    vehicle.now = 10.0
    assert vehicle.says()


def test_remembered_streams_are_bounded():
    vehicle = Vehicle()
    for link in range(200):
        assert vehicle.hears(station(KEY, link=link).beat())
    assert len(vehicle.gate._streams) == MAX_STREAMS


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 24), st.integers(1, 255))
def test_a_changed_byte_is_never_heard(position, change):
    """Of a signed heartbeat past its length and flags, which the parser itself needs."""
    vehicle, packet = Vehicle(), bytearray(station(KEY).beat())
    packet[4 + position] ^= change
    parser = dialect.MAVLink(None)
    parser.robust_parsing = True
    for message in parser.parse_buffer(bytes(packet)) or ():
        assert message.get_type() == "BAD_DATA" or not vehicle.gate.admits(message, local=False)
