"""Message signing: keys, monotonic timestamps, and refused packets."""

from __future__ import annotations

import asyncio
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.clock import ManualClock
from lfield.driver import DeviceBinding
from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, Writer, dialect
from lfield_mavlink.link.signing import LinkSigning, Signing, open_signing, sign_link
from lfield_mavlink.link.signing_timestamps import AHEAD, EPOCH, KEY, PER_SECOND, SigningTimestamps, load_key

KEY_BYTES = bytes(range(1, KEY + 1))
NOW = EPOCH + 1000.0


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "alpha.key"
    path.write_bytes(KEY_BYTES)
    path.chmod(0o600)
    return path


def stamps_of(path, *, time=NOW):
    clock = ManualClock(time)
    stamps = SigningTimestamps(path, clock)
    stamps.open()
    return stamps, clock


def beat():
    return dialect.MAVLink_heartbeat_message(2, 3, 129, 4, 4, 3)


def writer(key, timestamp, *, link=0, system=1):
    """The packer of a vehicle that signs."""
    mavlink = dialect.MAVLink(None, srcSystem=system, srcComponent=1)
    mavlink.signing.secret_key, mavlink.signing.sign_outgoing = key, True
    mavlink.signing.timestamp, mavlink.signing.link_id = timestamp, link
    return mavlink


def reader_of(key_file, **allow):
    stamps, _ = stamps_of(key_file)
    signing = Signing(KEY_BYTES, stamps)
    link = LinkSigning(signing, 1, allow_unsigned=allow.get("allow_unsigned", False))
    return Reader(link), signing, link


# -- keys -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", [KEY_BYTES, KEY_BYTES.hex().encode(), KEY_BYTES.hex().upper().encode() + b"\n"]
)
def test_key_file_in_bytes_or_hexadecimal_is_read(key_file, text):
    key_file.write_bytes(text)
    assert load_key(key_file) == KEY_BYTES


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_any_key_file_is_read_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("keys") / "key"
    path.write_bytes(data)
    path.chmod(0o600)
    try:
        key = load_key(path)
    except DeviceError:
        return
    assert len(key) == KEY


@pytest.mark.parametrize("text", [b"", b"short", bytes(KEY), b"0" * 2 * KEY, b"x" * 2 * KEY, b"y" * 1000])
def test_invalid_key_file_is_refused(key_file, text):
    key_file.write_bytes(text)
    with pytest.raises(DeviceError, match="signing key"):
        load_key(key_file)


def test_key_file_readable_by_others_is_refused(key_file):
    key_file.chmod(0o640)
    with pytest.raises(DeviceError, match="open to others; run: chmod 600"):
        load_key(key_file)


def test_missing_key_file_is_refused(tmp_path):
    with pytest.raises(DeviceError, match="cannot be read"):
        load_key(tmp_path / "nowhere")


# -- timestamps -------------------------------------------------------------------------------------------


def test_timestamps_increase_with_time_and_with_each_packet(key_file):
    stamps, clock = stamps_of(key_file)
    first = stamps.next()
    assert first == 1000 * PER_SECOND + 1
    assert stamps.next() == first + 1
    clock.advance(1.0)
    assert stamps.next() == 1001 * PER_SECOND


def test_timestamps_do_not_decrease_after_a_crash(key_file):
    stamps, clock = stamps_of(key_file)
    given_out = []
    for _ in range(100):
        clock.advance(1.0)
        given_out.append(stamps.next())
        if stamps.is_low:
            stamps.extend(stamps.due)
    # Also when the computer has lost its time.
    again, _ = stamps_of(key_file, time=EPOCH)
    assert again.next() > max(given_out)
    assert given_out == sorted(set(given_out))


def test_timestamps_stay_within_the_stored_limit(key_file):
    stamps, clock = stamps_of(key_file)
    clock.advance(1000.0)
    assert stamps.is_low
    assert stamps.next() == 1000 * PER_SECOND + AHEAD
    stamps.extend(stamps.due)
    assert stamps.next() == 2000 * PER_SECOND


def test_timestamps_follow_those_of_the_peer(key_file):
    stamps, _ = stamps_of(key_file)
    stamps.on_timestamp(1005 * PER_SECOND)
    assert stamps.next() == 1005 * PER_SECOND
    stamps.on_timestamp(3)
    assert stamps.next() == 1005 * PER_SECOND + 1


def test_two_processes_with_one_key_use_different_timestamps(key_file):
    (one, _), (two, _) = stamps_of(key_file), stamps_of(key_file)
    assert one.next() < two.next()
    one.extend(one.due)
    assert int((key_file.parent / "alpha.key.timestamp").read_text()) > two.next()


@settings(max_examples=100, deadline=None)
@given(st.binary(min_size=0, max_size=100))
def test_any_timestamp_file_is_read_or_refused(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("stamps")
    path = folder / "key"
    path.write_bytes(KEY_BYTES)
    (folder / "key.timestamp").write_bytes(data)
    try:
        stamps, _ = stamps_of(path)
    except DeviceError:
        return
    assert stamps.next() > int(data.strip())


def test_unwritable_timestamp_folder_is_refused(key_file):
    (key_file.parent / "alpha.key.timestamp.new").mkdir()
    with pytest.raises(DeviceError, match="cannot be stored"):
        stamps_of(key_file)


# -- packets ----------------------------------------------------------------------------------------------


def test_sent_packets_are_signed_with_new_timestamps(key_file):
    stamps, _ = stamps_of(key_file)
    link = LinkSigning(Signing(KEY_BYTES, stamps), 7, allow_unsigned=False)
    sends, vehicle = Writer(link), dialect.MAVLink(None)
    vehicle.robust_parsing = True
    vehicle.signing.secret_key, vehicle.signing.timestamp = KEY_BYTES, 1000 * PER_SECOND
    for _ in range(3):
        message = vehicle.parse_buffer(sends.pack(beat(), 128))[0]
        assert message.get_signed()
        assert message.get_link_id() == 7
    assert vehicle.signing.goodsig_count == 3


def test_signed_packet_is_accepted_once(key_file):
    reader, signing, _ = reader_of(key_file)
    packet = bytes(beat().pack(writer(KEY_BYTES, 1000 * PER_SECOND)))
    assert len(list(reader.feed(packet))) == 1
    assert list(reader.feed(packet)) == []
    assert (signing.valid_count, signing.invalid_count, reader.broken) == (1, 1, 0)


@pytest.mark.parametrize("allow", [True, False])
def test_wrong_key_or_old_timestamp_is_refused(key_file, allow):
    reader, signing, _ = reader_of(key_file, allow_unsigned=allow)
    wrong = beat().pack(writer(bytes(KEY), 1000 * PER_SECOND))
    old = beat().pack(writer(KEY_BYTES, 939 * PER_SECOND))
    ancient = beat().pack(writer(KEY_BYTES, 0))
    for packet in (wrong, old, ancient):
        assert list(reader.feed(packet)) == []
    assert (signing.valid_count, signing.invalid_count) == (0, 3)


def test_unsigned_packets_are_accepted_only_if_allowed(key_file):
    plain = bytes(beat().pack(dialect.MAVLink(None, srcSystem=1, srcComponent=1)))
    for force in (plain, bytes(beat().pack(dialect.MAVLink(None, srcSystem=1), force_mavlink1=True))):
        reader, _, link = reader_of(key_file)
        assert list(reader.feed(force)) == []
        assert link.unsigned == 1
        reader, _, link = reader_of(key_file, allow_unsigned=True)
        assert len(list(reader.feed(force))) == 1
        assert link.unsigned == 0


def test_forged_packet_does_not_block_later_packets(key_file):
    """pymavlink's own check stores a packet's timestamp before it checks the signature."""
    reader, _, _ = reader_of(key_file)
    assert list(reader.feed(beat().pack(writer(bytes(KEY), (1 << 48) - 1)))) == []
    assert len(list(reader.feed(beat().pack(writer(KEY_BYTES, 1000 * PER_SECOND))))) == 1


def test_packet_of_one_link_is_refused_on_another(key_file):
    stamps, _ = stamps_of(key_file)
    signing = Signing(KEY_BYTES, stamps)
    readers = [Reader(LinkSigning(signing, number, allow_unsigned=False)) for number in (1, 2)]
    packet = bytes(beat().pack(writer(KEY_BYTES, 1000 * PER_SECOND)))
    assert [len(list(reader.feed(packet))) for reader in readers] == [1, 0]


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=120), st.integers(0, 400), st.binary(min_size=1, max_size=3))
def test_modified_signed_packet_is_refused(tmp_path_factory, noise, at, change):
    path = tmp_path_factory.mktemp("keys") / "key"
    path.write_bytes(KEY_BYTES)
    reader, signing, _ = reader_of(path)
    packet = bytearray(beat().pack(writer(KEY_BYTES, 1000 * PER_SECOND)))
    list(reader.feed(noise))
    at %= len(packet)
    packet[at : at + len(change)] = change
    original = bytes(beat().pack(writer(KEY_BYTES, 1000 * PER_SECOND)))
    found = list(reader.feed(bytes(packet)))
    assert found == [] or bytes(packet).startswith(original)
    assert signing.valid_count == len(found)


# -- bindings ---------------------------------------------------------------------------------------------


def binding(key="", *, waivers=(), system=1):
    return DeviceBinding(
        agent=f"a{system}", field="fc", type="Mavlink", driver="mavlink", endpoint="udp:127.0.0.1:1",
        safe_state="land", options={"signing_key": str(key), "link_id": 5}, waivers=list(waivers),
    )  # fmt: skip


def test_binding_without_key_has_no_signing():
    assert open_signing([binding()], ManualClock()) is None
    assert sign_link(None, [binding()], 0, "udp:127.0.0.1:1") is None


def test_different_keys_on_one_endpoint_are_refused(key_file):
    with pytest.raises(DeviceError, match="must have the same key"):
        open_signing([binding(key_file), binding(system=2)], ManualClock())


@pytest.mark.parametrize(
    ("endpoint", "waivers", "refused"),
    [
        ("udp:127.0.0.1:1", (), True),
        ("tcp:127.0.0.1:1", (), True),
        ("serial:/dev/ttyACM0:57600", (), False),
        ("udp:127.0.0.1:1", ("unsigned",), False),
    ],
)
def test_unsigned_packets_are_refused_on_network_links(key_file, endpoint, waivers, refused):
    bindings = [binding(key_file, waivers=waivers)]
    signing = open_signing(bindings, ManualClock())
    reader = Reader(sign_link(signing, bindings, 0, endpoint))
    plain = beat().pack(dialect.MAVLink(None, srcSystem=1, srcComponent=1))
    assert (list(reader.feed(plain)) == []) is refused


async def test_timestamp_file_is_extended_and_a_write_error_reported_once(key_file, monkeypatch):
    monkeypatch.setattr("lfield_mavlink.link.signing.CHECK_INTERVAL", 0.001)
    stamps, clock = stamps_of(key_file)
    notes = []

    task = asyncio.create_task(Signing(KEY_BYTES, stamps).keep_ahead(notes.append))
    clock.advance(15.0)
    async with asyncio.timeout(60):
        while stamps.is_low:
            await asyncio.sleep(0.001)
    (key_file.parent / "alpha.key.timestamp.new").mkdir()
    clock.advance(1000.0)
    async with asyncio.timeout(60):
        while not notes:
            await asyncio.sleep(0.001)
    await asyncio.sleep(0.05)
    task.cancel()
    assert len(notes) == 1
    assert "may ignore packets" in notes[0]
    assert os.listdir(key_file.parent)
