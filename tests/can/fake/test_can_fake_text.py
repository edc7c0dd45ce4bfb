"""The text protocols of both endpoints, by bytes."""

from __future__ import annotations

import pytest

from lfield_sim.can.adapters import slcan, socketcand
from lfield_sim.can.adapters.slcan import SlcanProtocol
from lfield_sim.can.adapters.socketcand import SocketcandProtocol
from lfield_sim.can.can_bus import BUS_OFF, ERROR_BUS_OFF, PASSIVE, WARNING, CanFrame


def opened() -> SocketcandProtocol:
    protocol = SocketcandProtocol()
    assert protocol.command(b" open can0 ") == (b"< ok >", None)
    assert protocol.command(b" rawmode ") == (b"< ok >", None)
    return protocol


def test_socketcand_requires_open_then_rawmode():
    protocol = SocketcandProtocol()
    assert protocol.command(b" rawmode ")[0] == socketcand.UNKNOWN
    assert protocol.command(b" send 1 0 ")[0] == socketcand.UNKNOWN
    assert protocol.command(b" open vcan7 ")[0] == b"< error could not open bus >"
    assert protocol.command(b" echo ")[0] == b"< echo >"
    assert opened().raw


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        (b" send 123 2 a ff ", CanFrame(0x123, b"\x0a\xff")),
        (b" send 7FF 0  ", CanFrame(0x7FF)),
        (b" send 00000123 1 0 ", CanFrame(0x123, b"\0", extended=True)),
        (b" send 800 0 ", None),
        (b" send FFFFFFFF 0 ", None),
        (b" send 123 3 1 2 ", None),
        (b" send 123 9 1 2 3 4 5 6 7 8 9 ", None),
        (b" send 123 1 100 ", None),
        (b" send xyz 0 ", None),
    ],
)
def test_socketcand_parses_frames_and_ignores_malformed_ones(text, frame):
    assert opened().command(text) == (b"", frame)


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (CanFrame(0x5, b"\x01\xab"), b"< frame 005 12.000034 01AB >"),
        (CanFrame(0x5), b"< frame 005 12.000034  >"),
        (CanFrame(0x5, b"\x01", extended=True), b"< frame 00000005 12.000034 01 >"),
        (CanFrame(ERROR_BUS_OFF, error=True), b"< error 20000040 12.000034 >"),
        (CanFrame(0x5, remote=True), b""),
        (CanFrame(0x5, bytes(12), fd=True), b""),
    ],
)
def test_socketcand_encodes_frames(frame, text):
    assert SocketcandProtocol.encode(frame, 12.000034) == text


def test_commands_arrive_in_pieces_and_together():
    buffer = bytearray(b"junk < open can0 >< raw")
    assert socketcand.next_command(buffer) == b" open can0 "
    assert socketcand.next_command(buffer) is None
    buffer += b"mode >"
    assert socketcand.next_command(buffer) == b" rawmode "
    buffer = bytearray(b"V\rt1230\rF")
    assert [slcan.next_command(buffer), slcan.next_command(buffer), slcan.next_command(buffer)] == [
        b"V",
        b"t1230",
        None,
    ]


@pytest.mark.parametrize("cut", [slcan.next_command, socketcand.next_command])
def test_endless_command_is_discarded(cut):
    buffer = bytearray(b"<" + b"t" * 10_000)
    assert cut(buffer) is None
    assert not buffer


def dongle(*commands: bytes, errors: int = 0) -> tuple[SlcanProtocol, list[bytes]]:
    protocol = SlcanProtocol(lambda: errors)
    return protocol, [protocol.command(command)[0] for command in commands]


def test_slcan_is_configured_and_opened():
    protocol, answers = dongle(b"C", b"S6", b"Y5", b"V", b"N", b"O", b"O", b"S8", b"F", b"C", b"L", b"t1230")
    bad, ok = b"\a", b"\r"
    assert answers == [bad, ok, ok, b"V1013\r", b"NF4K3\r", ok, bad, bad, b"F00\r", ok, ok, bad]
    assert (protocol.bitrate, protocol.opened) == (500_000, True)


@pytest.mark.parametrize(
    "command", [b"S", b"SX", b"S66", b"Y3", b"O1", b"C1", b"M12", b"s12", b"W", b"\xff", b"F"]
)
def test_slcan_refuses_invalid_commands(command):
    assert dongle(command)[1] == [b"\a"]


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (CanFrame(0x123, b"\x01\xab"), b"t123201AB"),
        (CanFrame(0x123, b"\x01", extended=True), b"T00000123101"),
        (CanFrame(0x123, remote=True, dlc=8), b"r1238"),
        (CanFrame(0x123, remote=True, dlc=2, extended=True), b"R000001232"),
        (CanFrame(0x123, bytes(12), fd=True), b"d1239" + b"00" * 12),
        (CanFrame(0x123, bytes(64), fd=True, extended=True), b"D00000123F" + b"00" * 64),
        (CanFrame(0x123, bytes(48), fd=True, switch=True), b"b123E" + b"00" * 48),
        (CanFrame(0x123, fd=True, switch=True, extended=True), b"B000001230"),
    ],
)
def test_slcan_encodes_and_decodes_frames(frame, text):
    protocol, _ = dongle(b"O")
    assert protocol.command(text) == (b"Z\r" if frame.extended else b"z\r", frame)
    assert SlcanProtocol.encode(frame) == text + b"\r"


@pytest.mark.parametrize(
    "text", [b"t8000", b"t1239" + b"00" * 9, b"t12320", b"t12", b"t123100 ", b"T200000000", b"d123A00"]
)
def test_slcan_refuses_malformed_frames(text):
    protocol, _ = dongle(b"O")
    assert protocol.command(text) == (b"\a", None)


@pytest.mark.parametrize(
    ("errors", "flags"), [(0, b"F00\r"), (WARNING, b"F04\r"), (PASSIVE, b"F24\r"), (BUS_OFF, b"FA4\r")]
)
def test_slcan_status_flags(errors, flags):
    assert dongle(b"O", b"F", errors=errors)[1][1] == flags


def test_slcan_does_not_encode_error_frames():
    assert SlcanProtocol.encode(CanFrame(ERROR_BUS_OFF, error=True)) == b""
