"""The log of MAVLink packets: both directions, readable by pymavlink, without keys."""

from __future__ import annotations

import pytest
from pymavlink import mavutil

from lfield.clock import ManualClock
from lfield.driver.recording import WireLog
from lfield.recording.ring_writer import RingWriter
from lfield_mavlink.link.dialect import Reader, Writer, dialect
from lfield_mavlink.link.signing import LinkSigning, Signing

NOW = 1_609_459_200.123456


def ring_in(folder):
    """Makes ring writers in `folder`; a write failure fails the test."""

    def make(suffix, header):
        return RingWriter(folder, "wire-a1.fc", suffix, 1 << 20, pytest.fail, header)

    return make


def messages_in(folder):
    """The messages that pymavlink reads from the log."""
    (path,) = folder.glob("*.tlog")
    assert path.stat().st_mode & 0o777 == 0o600
    log = mavutil.mavlink_connection(str(path))
    found = []
    while (message := log.recv_match()) is not None:
        found.append(message)
    log.close()
    return found


def logged(folder, *packets, time=NOW):
    log = WireLog(ManualClock(time))
    log.start(ring_in(folder))
    for packet in packets:
        log.log_mavlink(packet)
    log.close()


def signing_message():
    return dialect.MAVLink_setup_signing_message(1, 1, list(b"s3cret" * 5 + b"xy"), 7)


def test_pymavlink_reads_both_directions_of_the_log(bench, tmp_path):
    b = bench()
    received = []

    def filtered(link, packet):
        received.append(packet)
        link.on_data(packet)

    b.filter = filtered

    async def mission(fc):
        b.sent.clear()
        received.clear()
        b.driver.wire_log.start(ring_in(tmp_path))
        await fc.execute("arm", [])
        b.driver.wire_log.close()
        return len(b.sent), len(received)

    sent, arrived = b.run(mission)
    found = messages_in(tmp_path)
    from_us = [message for message in found if message.get_srcComponent() == 191]
    assert (len(from_us), len(found) - len(from_us)) == (sent, arrived)
    assert {"COMMAND_LONG", "HEARTBEAT"} <= {message.get_type() for message in from_us}
    assert "BAD_DATA" not in {message.get_type() for message in found}
    times = [message._timestamp for message in found]
    assert times == sorted(times)


def test_log_entry_has_microseconds_and_the_packet(tmp_path):
    packet = Writer().pack(dialect.MAVLink_heartbeat_message(2, 3, 129, 4, 4, 3), 1)
    logged(tmp_path, packet)
    (path,) = tmp_path.iterdir()
    assert path.name == "wire-a1.fc-000001.tlog"
    assert path.read_bytes() == (1_609_459_200_123_456).to_bytes(8, "big") + packet
    (message,) = messages_in(tmp_path)
    assert message._timestamp == pytest.approx(NOW, abs=2e-6)


AUTH_KEY = dialect.MAVLink_auth_key_message(b"s3cret")
CONTROL = dialect.MAVLink_change_operator_control_message(1, 0, 0, b"s3cret")


@pytest.mark.parametrize(
    ("message", "version"),
    [
        (signing_message(), 2),
        (dialect.MAVLink_wifi_config_ap_message(b"field", b"s3cret"), 2),
        (AUTH_KEY, 1),
        (AUTH_KEY, 2),
        (CONTROL, 1),
        (CONTROL, 2),
    ],
)
def test_no_message_with_a_key_or_password_is_logged(tmp_path, message, version):
    packer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    packet = bytes(message.pack(packer, force_mavlink1=version == 1))
    heartbeat = bytes(dialect.MAVLink_heartbeat_message(2, 3, 129, 4, 4, 3).pack(packer))
    logged(tmp_path, packet, heartbeat)
    (path,) = tmp_path.iterdir()
    assert b"s3cret" not in path.read_bytes()
    assert [message.get_type() for message in messages_in(tmp_path)] == ["HEARTBEAT"]


def test_packets_of_a_stream_are_logged_without_noise():
    packets, writer = [], Writer()
    for number in range(20):
        packets.append(writer.pack(dialect.MAVLink_system_time_message(number, number), 1))
    damaged = bytearray(packets[5])
    damaged[-1] ^= 1
    stream = b"".join([*packets[:5], b"noise", bytes(damaged), *packets[6:]])
    for size in (1, 7, 1000):
        found = []
        reader = Reader(on_packet=found.append)
        for start in range(0, len(stream), size):
            reader.feed(stream[start : start + size])
        assert found == [*packets[:5], *packets[6:]]


def test_packet_with_a_refused_signature_is_logged():
    class Stamps:
        latest = 0

        def on_timestamp(self, timestamp):
            pass

    found = []
    link = LinkSigning(Signing(bytes(32), Stamps()), 0, allow_unsigned=False)
    packet = Writer().pack(dialect.MAVLink_heartbeat_message(2, 3, 129, 4, 4, 3), 1)
    assert list(Reader(link, found.append).feed(packet)) == []
    assert found == [packet]


def test_log_is_empty_before_start_and_after_close(tmp_path):
    log = WireLog(ManualClock(NOW))
    packet = Writer().pack(dialect.MAVLink_heartbeat_message(2, 3, 129, 4, 4, 3), 1)
    log.log_mavlink(packet)
    log.close()
    log.log_mavlink(packet)
    assert list(tmp_path.iterdir()) == []
