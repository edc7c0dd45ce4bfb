"""Message signing of the fake against pymavlink: accepted senders, and signed answers."""

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
            assert self.accepts(Station(None).setup(key))

    def accepts(self, packet, *, local=False):
        (message,) = dialect.MAVLink(None).parse_buffer(packet)
        return self.gate.admits(message, local=local)

    def heartbeat(self):
        packer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self.gate.seal(packer)
        return bytes(dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(packer))


class Station:
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


def test_without_a_key_every_packet_is_accepted_and_none_signed():
    vehicle = Vehicle(key=None)
    assert vehicle.accepts(Station(None).beat())
    assert vehicle.accepts(Station(OTHER).beat())
    assert not vehicle.heartbeat()[2] & dialect.MAVLINK_IFLAG_SIGNED


def test_unsigned_packet_is_accepted_only_on_the_serial_port():
    vehicle = Vehicle()
    assert not vehicle.accepts(Station(None).beat())
    assert vehicle.accepts(Station(None).beat(), local=True)


def test_packet_with_the_wrong_key_is_refused():
    vehicle = Vehicle()
    assert vehicle.accepts(Station(KEY).beat())
    assert not vehicle.accepts(Station(OTHER, link=2).beat())


def test_answers_are_signed_with_increasing_timestamps():
    vehicle, client = Vehicle(), Station(KEY)
    received = [client.mav.parse_buffer(vehicle.heartbeat()) for _ in range(3)]
    assert [m.get_type() for (m,) in received] == ["HEARTBEAT"] * 3
    assert (client.mav.signing.goodsig_count, client.mav.signing.badsig_count) == (3, 0)
    other = Station(OTHER)
    assert [m.get_type() for m in other.mav.parse_buffer(vehicle.heartbeat())] == ["BAD_DATA"]
    assert other.mav.signing.badsig_count == 1


def test_replayed_packet_is_ignored():
    vehicle, client = Vehicle(), Station(KEY)
    packet = client.beat()
    assert vehicle.accepts(packet)
    assert not vehicle.accepts(packet)
    assert vehicle.accepts(client.beat())


@pytest.mark.parametrize(("behind", "accepted"), [(59, True), (61, False), (11 * 365 * 86_400, False)])
def test_timestamp_older_than_a_minute_is_ignored(behind, accepted):
    vehicle = Vehicle()
    assert vehicle.accepts(Station(KEY, timestamp=NOW - behind * PER_SECOND).beat()) is accepted


def test_accepted_timestamps_advance_with_the_vehicle_clock():
    vehicle = Vehicle()
    vehicle.now = 100.0
    assert not vehicle.accepts(Station(KEY, timestamp=NOW + 39 * PER_SECOND).beat())
    assert vehicle.accepts(Station(KEY, timestamp=NOW + 41 * PER_SECOND).beat())


def test_future_timestamp_advances_the_vehicle_clock():
    vehicle = Vehicle()
    assert vehicle.accepts(Station(KEY, timestamp=NOW + 1000 * PER_SECOND).beat())
    assert not vehicle.accepts(Station(KEY, link=2).beat()), "a new stream is more than a minute behind now"


def test_key_is_changed_only_with_the_current_key():
    vehicle = Vehicle()
    assert not vehicle.accepts(Station(None).setup(OTHER))
    assert not vehicle.accepts(Station(OTHER).setup(OTHER))
    assert vehicle.gate.key == KEY
    assert vehicle.accepts(Station(KEY).setup(OTHER, target=9))
    assert vehicle.gate.key == KEY, "the message was for another system"
    assert vehicle.accepts(Station(KEY, link=2).setup(OTHER))
    assert vehicle.gate.key == OTHER
    assert vehicle.accepts(Station(None).setup(bytes(32)), local=True)
    assert vehicle.gate.key is None, "a key of zeros disables signing"


def test_greatest_timestamp_is_survived():
    vehicle = Vehicle(key=None)
    vehicle.accepts(Station(None).setup(KEY, timestamp=(1 << 64) - 1))
    vehicle.now = 10.0
    assert vehicle.heartbeat()


def test_remembered_streams_are_bounded():
    vehicle = Vehicle()
    for link in range(200):
        assert vehicle.accepts(Station(KEY, link=link).beat())
    assert len(vehicle.gate._streams) == MAX_STREAMS


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 24), st.integers(1, 255))
def test_packet_with_a_changed_byte_is_refused(position, change):
    """Changes a byte of a signed heartbeat after its length and flags, which the parser needs."""
    vehicle, packet = Vehicle(), bytearray(Station(KEY).beat())
    packet[4 + position] ^= change
    parser = dialect.MAVLink(None)
    parser.robust_parsing = True
    for message in parser.parse_buffer(bytes(packet)) or ():
        assert message.get_type() == "BAD_DATA" or not vehicle.gate.admits(message, local=False)
