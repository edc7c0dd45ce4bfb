"""Messages as bytes: encoding and decoding, bounds, and invalid bytes."""

import math
import zlib
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from lfield.errors import WireError
from lfield.wire.codec import (
    CONTROL,
    HELLO,
    MAX_TRANSFER_HEADER,
    REFUSE,
    TRANSFER,
    decode,
    decode_transfer,
    encode,
    encode_transfer,
    frame_decoder,
    limits,
)
from lfield.wire.coordinator_messages import (
    CallsEnded,
    CancelCalls,
    CheckpointId,
    CoordinatorState,
    LeaseRecord,
    Locate,
    Located,
    Terminated,
    TerminatedAck,
    Transfer,
    TransferAccepted,
    TransferQuery,
    TransferRefused,
    WatchCalls,
)
from lfield.wire.fields import MAX_LABEL, MAX_NAME, MAX_NUMBERS, MAX_TEXT, truncate
from lfield.wire.framing import HEADER_SIZE
from lfield.wire.messages import (
    AgentUpdate,
    AttributeUpdate,
    DirectoryUpdate,
    GossipUpdate,
    GroundQuery,
    GroundReport,
    HandshakeRefused,
    Hello,
    IncompatibleHello,
    LivenessCounter,
    Ping,
    Pong,
    RelayedMessage,
)
from lfield.wire.observer_messages import (
    AgentStatus,
    AttributeReading,
    DeviceStatus,
    DirectoryEntry,
    ForgetRequest,
    ForgetResponse,
    JournalStatus,
    LinkStatus,
    ParkedStatus,
    PendingCallStatus,
    RecoverRequest,
    ReservedStatus,
    Status,
)
from lfield.wire.quorum_messages import Promise
from lfield.wire.reservation_messages import ReleaseReservation, RenewReservation
from lfield.wire.subscription_messages import EventBatch, Subscribe

HASH = b"h" * 32
REPEATABLE = settings(derandomize=True, deadline=None)


def status(**changes):
    snapshot = replace(Status("a", "a:1", 0.5, HASH, HASH, [], [], [], [], []), **changes)
    return EventBatch(7, 1, 1.7e9, 0.5, 5, 5, [], {}, snapshot)


AGENT = AgentStatus("Tour:one", "Tour", "coordinator", "ready", 1, 0, 12, 1 << 20, 1)
DEVICE = DeviceStatus("one.fc", {"mode": "hold", "at": [1, -0.5], "on": True, "n": 3, "v": 0.5}, 0.25, "")
ENTRY = DirectoryEntry(
    "one", "", {"battery": AttributeReading(0.5, 2.5)}, {"mode": "fc has not reported mode"}
)
KNOWN = CoordinatorState("Tour:one", 1, 2, 3, "EXITED", "b", "died", "…")
STATUS = status(
    agents=[AGENT], coordinators=[KNOWN], devices=[DEVICE], links=[LinkStatus("b", None)], directory=[ENTRY]
)
HELLO_MESSAGE = Hello(
    "host",
    "a",
    2**63 - 1,
    HASH,
    HASH,
    1 << 20,
    [KNOWN],
    HASH,
)
MESSAGES = [
    HELLO_MESSAGE,
    Hello("observer", "ps", 1),
    HandshakeRefused("wrong program"),
    TransferAccepted("Tour:one", 1, 2),
    TransferRefused("Tour:one", 1, 2, "LimitException", "full"),
    TransferQuery("Tour:one", 1, 2, 3),
    RelayedMessage(LivenessCounter(2, 7, 1), 0, TransferQuery("Tour:one", 1, 2, 3)),
    RelayedMessage(
        LivenessCounter(0, 2**63 - 1, 9), 2, TransferRefused("Tour:one", 1, 2, "LimitException", "full")
    ),
    Terminated("Tour:one", 1, "done", "", "a"),
    TerminatedAck("Tour:one", 1),
    Locate(["Tour:one"], leases=True),
    Located([], [KNOWN]),
    Located(["Tour:one"], [], [LeaseRecord("Tour:one", CheckpointId(1, 2, was_sent=True), "b", 1, 0.5)]),
    GroundQuery(),
    GroundReport({"one.fc": True, "two.fc": None}),
    Subscribe(once=True),
    STATUS,
    status(devices=[DeviceStatus("one.fc", {}, None, "why")], links=[LinkStatus("b", 2.5)]),
    status(journal=JournalStatus(3, "full", [ParkedStatus("one", 1, 2, HASH, "PREPARED", "b")])),
    status(reserved=[ReservedStatus("arm", "Tour:one", 2, 12.5, 3.5)]),
    status(pending_calls=[PendingCallStatus("Tour:one", 2, "arm", "lift", "running")]),
    ForgetRequest("Tour:one"),
    ForgetResponse([1, 3]),
    Ping(1),
    Pong(1),
    DirectoryUpdate(
        1, 0, 1, [AgentUpdate(3, "fc: no message", 3.5, [AttributeUpdate(0, 0.75, 0.5, True)], [(1, "…")])]
    ),
    DirectoryUpdate(2**63 - 1, 6, 7, [AgentUpdate(0, "", None, [], [])]),
    DirectoryUpdate(1, 0, 1, [AgentUpdate(3, "", None, [], [], "pilot", 12.5)]),
    RenewReservation("arm", 2**62, "Tour:one", 3),
    ReleaseReservation("arm", 7),
    WatchCalls("Tour:one", 2**62, [1, 2**63 - 1]),
    CallsEnded("Tour:one", 3, [7]),
    CancelCalls("Tour:one", 3, [7]),
]


def report(agent=0, trouble="", lasting=None, facts=(), unknown=(), since=0):
    return DirectoryUpdate(1, since, 1, [AgentUpdate(agent, trouble, lasting, list(facts), list(unknown))])


TRANSFER_HEADER = Transfer("Tour:one", 1, 2, 3, HASH, 4, 5)


def decoder_of_a_host(max_block: int, skipped: list):
    decoder = frame_decoder(lambda *transfer: skipped.append(transfer))
    decoder.limits = limits("host", max_block)
    return decoder


def kind_and_payload(frame: bytes) -> tuple[int, bytes]:
    return frame[HEADER_SIZE - 1], frame[HEADER_SIZE:]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_each_message_is_restored(message):
    assert decode(*kind_and_payload(encode(message))) == message
    assert (
        decode(kind_and_payload(encode(message))[0], memoryview(kind_and_payload(encode(message))[1]))
        == message
    )


NAMES = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=MAX_NAME)
NUMBERS = st.integers(0, 2**63 - 1)


@REPEATABLE
@given(
    st.builds(RenewReservation, NAMES, NUMBERS, NAMES, NUMBERS)
    | st.builds(ReleaseReservation, NAMES, NUMBERS)
    | st.builds(lambda *fields: status(reserved=[ReservedStatus(*fields, 1.5, 0.25)]), NAMES, NAMES, NUMBERS)
)
def test_reservation_messages_are_restored(message):
    assert decode(*kind_and_payload(encode(message))) == message


def test_a_transfer_is_its_header_and_the_unchanged_block():
    kind, payload = kind_and_payload(encode_transfer(TRANSFER_HEADER, b"block") + b"block")
    assert kind == TRANSFER
    header, block = decode_transfer(payload)
    assert header == TRANSFER_HEADER
    assert bytes(block) == b"block"
    assert block.obj is payload


def test_the_largest_transfer_header_fits():
    largest = Transfer("\U0010ffff" * MAX_NAME, *[2**62] * 3, HASH, 2**63 - 1, 0)
    assert len(encode_transfer(largest, b"")) - HEADER_SIZE <= MAX_TRANSFER_HEADER
    assert decode_transfer(kind_and_payload(encode_transfer(largest, b""))[1])[0] == largest


def test_a_hello_starts_with_its_magic_number_and_version():
    kind, payload = kind_and_payload(encode(HELLO_MESSAGE))
    assert (kind, payload[:6]) == (HELLO, b"lfld\x00\x11")
    assert kind_and_payload(encode(HandshakeRefused("no"))) == (REFUSE, b"no")


def test_a_hello_of_a_later_version_shows_its_version():
    assert decode(HELLO, b"lfld\x00\x63 unknown content") == IncompatibleHello(99)


def with_checksum(start: bytes, body: bytes) -> bytes:
    """A payload with any content and its correct checksum."""
    size = len(start) + 4 + len(body)
    return start + zlib.crc32(body, size).to_bytes(4, "big") + body


@pytest.mark.parametrize(
    ("kind", "payload", "words"),
    [
        (HELLO, b"", "too short"),
        (HELLO, b"lfl", "too short"),
        (HELLO, b"http/1", "does not begin with 'lfld'"),
        (HELLO, b"lfld\x00\x11", "too short to have a checksum"),
        (HELLO, b"lfld\x00\x11" + bytes(8), "was damaged"),
        (CONTROL, b"", "too short to have a checksum"),
        (CONTROL, b"\x92\x08\x01", "too short to have a checksum"),
        (CONTROL, bytes(4), "was damaged"),
        (CONTROL, bytes(4) + b"\x92\x08\x01", "was damaged"),
        (TRANSFER, b"", "not a message"),
        (3, b"", "not a message"),
        (99, b"", "not a message"),
    ],
)
def test_invalid_bytes_are_a_wire_error(kind, payload, words):
    with pytest.raises(WireError, match=words):
        decode(kind, payload)


@pytest.mark.parametrize(
    ("kind", "start", "body"),
    [
        (HELLO, b"lfld\x00\x11", b""),
        (CONTROL, b"", b""),
        (CONTROL, b"", b"\xc1"),
        (CONTROL, b"", b"\x92\x63\x01"),
        (CONTROL, b"", b"\x92\x08\xa1x"),
        (CONTROL, b"", b"\x92\x08\xff"),
        (CONTROL, b"", b"\x94\x08\x01\x01\x01"),
        (CONTROL, b"", b"\x92\x08\x01\x01"),
        (CONTROL, b"", b"\x93\x05\xa1\xff\x01"),
        (CONTROL, b"", b"\x92\x07" + b"\x81\xa1a" * 5000 + b"\xc0"),
        (CONTROL, b"", b"\x92\x07\x81\x90\x01"),
    ],
)
def test_an_invalid_message_with_a_correct_checksum_is_a_wire_error(kind, start, body):
    with pytest.raises(WireError, match="cannot be read"):
        decode(kind, with_checksum(start, body))


@pytest.mark.parametrize(
    "message",
    [
        TransferAccepted("", 1, 1),
        TransferAccepted("x" * (MAX_NAME + 1), 1, 1),
        TransferAccepted("Tour:one", -1, 1),
        TransferAccepted("Tour:one", 1, 2**62 + 1),
        TransferAccepted("Tour:one", 2**62 + 1, 1),
        status(coordinators=[replace(KNOWN, hops=2**62 + 1)]),
        RecoverRequest("Tour:one", 1, 1, above=2**62 + 1),
        Promise("Tour:one", 1, fence=2**62 + 1, checkpoint=None),
        GossipUpdate([LivenessCounter(1, 1, 2**62 + 1)], []),
        TransferRefused("Tour:one", 1, 1, "LimitException", "x" * (MAX_TEXT + 1)),
        Terminated("Tour:one", 1, "asleep", "", "a"),
        Hello("host", "a", 1, b"h" * 33),
        Hello("king", "a", 1),
        Hello("host", "a", 1, coordinators=[CoordinatorState("Tour:one", 1, 1, 1, "RUN")] * 4097),
        RenewReservation("", 1, "Tour:one", 1),
        RenewReservation("arm", -1, "Tour:one", 1),
        RenewReservation("arm", 1, "Tour:one", 2**63),
        ReleaseReservation("x" * (MAX_NAME + 1), 1),
        ReleaseReservation("arm", -1),
        WatchCalls("", 1, [1]),
        WatchCalls("Tour:one", 1, []),
        CallsEnded("Tour:one", -1, [1]),
        CallsEnded("Tour:one", 1, [-1]),
        CallsEnded("Tour:one", 1, [1] * 4097),
        DirectoryUpdate(1, 0, 1, [AgentUpdate(3, "", None, [], [], "x" * (MAX_NAME + 1), 1.0)]),
        DirectoryUpdate(1, 0, 1, [AgentUpdate(3, "", None, [], [], "pilot", -1.0)]),
        status(reserved=[ReservedStatus("arm", "", 2, 12.5, 3.5)]),
        status(reserved=[ReservedStatus("arm", "pilot", 2, math.nan, 3.5)]),
        Hello("host", "a", 1, reservation=-1.0),
        report(agent=-1),
        report(agent=2**16),
        report(since=-1),
        report(trouble="x" * (MAX_LABEL + 1)),
        report(lasting=math.nan),
        report(lasting=-1.0),
        report(facts=[AttributeUpdate(0, 1.0, math.nan, True)]),
        report(facts=[AttributeUpdate(0, 1.0, math.inf, True)]),
        report(facts=[AttributeUpdate(0, 1.0, -0.5, True)]),
        report(facts=[AttributeUpdate(0, None, 0.0, True)]),
        report(facts=[AttributeUpdate(0, [1], 0.0, True)]),
        report(facts=[AttributeUpdate(0, "x" * (MAX_LABEL + 1), 0.0, True)]),
        report(facts=[AttributeUpdate(0, 1, 0.0, 1)]),
        report(facts=[AttributeUpdate(0, 1, 0.0, True)] * 1025),
        report(unknown=[(0, "x" * (MAX_LABEL + 1))]),
        status(host=""),
        status(up=-1.0),
        status(up=math.inf),
        status(program=b"h" * 33),
        status(agents=[AGENT] * 4097),
        status(agents=[replace(AGENT, kind="king")]),
        status(agents=[replace(AGENT, heap=-1)]),
        status(coordinators=[replace(KNOWN, state="ASLEEP")]),
        status(devices=[replace(DEVICE, telemetry={"at": [0.0] * (MAX_NUMBERS + 1)})]),
        status(devices=[replace(DEVICE, telemetry={"at": [[0.0]]})]),
        status(devices=[replace(DEVICE, telemetry={"at": None})]),
        status(devices=[replace(DEVICE, telemetry={str(n): n for n in range(1025)})]),
        status(devices=[replace(DEVICE, silent=-0.5)]),
        status(devices=[replace(DEVICE, latched="x" * (MAX_TEXT + 1))]),
        status(links=[LinkStatus("b", math.nan)]),
        status(links=[LinkStatus("", 1.0)]),
        status(directory={}),
        status(directory=[1]),
        status(directory=[["first", ""]]),
        status(directory=[replace(ENTRY, facts={"battery": [1.0]})]),
        status(directory=[replace(ENTRY, facts={"battery": AttributeReading(1.0, "old")})]),
        status(directory=[replace(ENTRY, facts={"battery": AttributeReading([1.0], 1.0)})]),
        status(directory=[replace(ENTRY, refusal="x" * (MAX_TEXT + 1))]),
        status(pending_calls=[PendingCallStatus("", 1, "arm", "lift", "done")]),
        status(pending_calls=[["Tour:one", 1, "arm", "lift", "flies"]]),
        DirectoryUpdate(1, 0, 1, [AgentUpdate(0, "", None, [], [])] * 4097),
    ],
)
def test_a_value_out_of_bounds_is_a_wire_error(message):
    with pytest.raises(WireError):
        decode(*kind_and_payload(encode(message)))


@pytest.mark.parametrize(
    "payload", [b"", b"\x00", b"\xff\xff" + bytes(2000), b"\x00\x05abc", b"\x00\x01\xc1"]
)
def test_an_invalid_transfer_is_a_wire_error(payload):
    with pytest.raises(WireError):
        decode_transfer(payload)


def test_a_transfer_must_have_the_size_in_its_header():
    with pytest.raises(WireError, match="promised 5 bytes and has 4"):
        decode_transfer(kind_and_payload(encode_transfer(TRANSFER_HEADER, b"four") + b"four")[1])


@REPEATABLE
@given(st.sampled_from([HELLO, REFUSE, TRANSFER, CONTROL]), st.binary(max_size=200))
def test_any_bytes_are_decoded_or_raise_a_wire_error(kind, payload):
    with suppress(WireError):
        decode_transfer(payload) if kind == TRANSFER else decode(kind, payload)


@REPEATABLE
@given(st.sampled_from(MESSAGES), st.data())
def test_a_changed_message_with_a_correct_checksum_is_decoded_or_a_wire_error(message, data):
    kind, payload = kind_and_payload(encode(message))
    start = {HELLO: 6, CONTROL: 0}.get(kind)
    body = bytearray(payload if start is None else payload[start + 4 :])
    for _ in range(data.draw(st.integers(1, 3))):
        body[data.draw(st.integers(0, len(body) - 1))] = data.draw(st.integers(0, 255))
    with suppress(WireError):
        decode(kind, bytes(body) if start is None else with_checksum(payload[:start], bytes(body)))


def flips(data: bytes):
    """The same bytes with one bit flipped, for every bit."""
    for bit in range(8 * len(data)):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        yield bytes(flipped)


BLOCK = bytes(range(256))


@pytest.mark.parametrize(
    "data",
    [
        encode(HELLO_MESSAGE),
        encode(TransferAccepted("Tour:one", 1, 2)),
        encode(TransferQuery("Tour:one", 1, 2, 3)),
        encode(Ping(1)),
        encode_transfer(replace(TRANSFER_HEADER, size=256), BLOCK) + BLOCK,
    ],
    ids=["Hello", "TransferAccepted", "TransferQuery", "Ping", "Transfer"],
)
def test_a_frame_with_one_flipped_bit_is_never_accepted(data):
    accepted, foreign = [], 0

    def read(kind, payload):
        return decode_transfer(payload) if kind == TRANSFER else decode(kind, payload)

    for flipped in flips(data):
        decoder = decoder_of_a_host(1 << 20, accepted)
        try:
            # The next frame shows that an increased length does not hide the damage.
            for kind, payload in decoder.feed(flipped + encode(Ping(2))):
                message = read(kind, payload)
                if isinstance(message, IncompatibleHello):
                    foreign += 1
                    break
                accepted.append(message)
            assert decoder.is_mid_frame or isinstance(message, IncompatibleHello), (
                "the decoder waits for the rest of the frame"
            )
        except WireError:
            pass
    assert accepted == []
    # The version precedes all fields that may change between versions: damaged, it is another version.
    assert foreign == (16 if data[4] == HELLO else 0)


def test_a_damaged_oversize_transfer_is_not_reported():
    """A report from a damaged header would throw a false LimitException in the program."""
    big = Transfer("Tour:one", 1, 2, 3, HASH, 4, 5000)
    data, skipped = encode_transfer(big, bytes(5000)), []
    for flipped in flips(data):
        decoder = decoder_of_a_host(1000, skipped)
        with suppress(WireError):
            list(decoder.feed(flipped + bytes(5000)))
    assert skipped == []


def test_an_oversize_transfer_is_reported_with_its_header():
    skipped = []
    decoder = decoder_of_a_host(1000, skipped)
    big = Transfer("Tour:one", 1, 2, 3, HASH, 4, 5000)
    assert list(decoder.feed(encode_transfer(big, bytes(5000)) + bytes(5000))) == []
    assert skipped == [(big, 5000)]


def test_an_oversize_transfer_with_an_invalid_header_is_a_wire_error():
    decoder = decoder_of_a_host(1000, [])
    with pytest.raises(WireError):
        list(decoder.feed(b"\x00\x00\x20\x00\x07" + bytes(8191)))


def test_a_long_text_is_cut_to_the_limit_of_a_message():
    assert truncate("short") == "short"
    assert len(truncate("x" * 5000)) == MAX_TEXT
    assert len(truncate("x" * 5000, MAX_LABEL)) == MAX_LABEL
    assert len(decode(*kind_and_payload(encode(HandshakeRefused("x" * 5000)))).reason) == MAX_TEXT


def test_a_hello_with_thousands_of_ended_coordinators_is_accepted():
    ended_coordinators = [
        CoordinatorState(f"Tour:{n}", 1, 2, 3, "EXITED", "b", "died", "x" * MAX_TEXT) for n in range(4096)
    ]
    frame = encode(replace(HELLO_MESSAGE, coordinators=ended_coordinators))
    ((kind, payload),) = frame_decoder(lambda *transfer: None).feed(frame)
    assert [known.agent for known in decode(kind, payload).coordinators] == [
        known.agent for known in ended_coordinators
    ]
