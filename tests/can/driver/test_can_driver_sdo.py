"""The core of the SDO client: a server that answers in order, late or never, with invalid frames between.

Every value and every abort code of the server occurs once, so that an old answer is detected.
"""

from __future__ import annotations

import struct
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield_can.protocols.sdo import (
    ABORT,
    ANSWER,
    LONGEST,
    PROBES,
    TRIES,
    Done,
    Failed,
    Refused,
    SdoClient,
    Send,
)
from lfield_sim.can.canopen.sdo import SdoAbort, SdoServer

KEY, OTHER = (0x6064, 0), (0x6041, 0)
#: Lengths of the objects of the server; it has no other objects.
LENGTHS = {KEY: 4, OTHER: 2, (0x1008, 0): 20, (0x100A, 0): 7, (0x1018, 1): 4, (0x2000, 3): 60}
#: Greatest delay of an answer in timeouts: fewer than there are probes.
LATEST = 14


class Objects:
    """The objects of a server: each read and each refusal has a number of its own."""

    def __init__(self) -> None:
        self.serial = 0
        self.refuses = False
        self.writes = []

    def read(self, key):
        self._count(key)
        return self.serial.to_bytes(2, "little").ljust(LENGTHS[key], b"\xee")

    def check_writable(self, key):
        return LENGTHS[key]

    def write(self, key, data):
        self._count(key)
        self.writes.append((self.serial, key, data))

    def _count(self, key):
        self.serial += 1
        if self.refuses or key not in LENGTHS:
            raise SdoAbort(0x0800_0000 + self.serial)


class Line:
    """The client and a server whose answers arrive in order, each after `late` timeouts."""

    def __init__(self) -> None:
        self.client, self.objects = SdoClient(), Objects()
        self.server = SdoServer(self.objects)
        self.coming: deque[list] = deque()
        self.waits = 0
        self.requests = 0

    def do(self, effects, late, lost, noise):
        """Carry out effects; returns the result when there is one."""
        for effect in effects:
            if not isinstance(effect, Send):
                return effect
            assert len(effect.data) == 8
            assert (effect.within is None) == (effect.data[0] == ABORT)
            if effect.within is not None:
                self.requests += 1
                assert self.client.on_response(nonsense(effect.data, noise)) == []
            if lost == "request":
                continue
            answer = self.server.answer(effect.data)
            if answer is not None and lost != "answer":
                # No answer overtakes another one.
                due = max([self.waits + late, *(due for due, _ in self.coming)])
                self.coming.append([due, answer])
        return None

    def run(self, effects, fates):
        """Run a transfer to its end; returns its result, or None when it was cancelled."""
        result = self.do(effects, *next(fates))
        while result is None:
            late, lost, noise = next(fates)
            if lost == "cancelled":
                return self.do(self.client.on_cancelled(), late, "", noise)
            if self.coming and self.coming[0][0] <= self.waits:
                frame = self.coming.popleft()[1]
                result = self.do(self.client.on_response(frame), late, lost, noise)
            else:
                self.waits += 1
                result = self.do(self.client.on_timeout(), late, lost, noise)
        return result


def nonsense(request, noise):
    """A frame that is not an answer to a request, of one of several kinds."""
    way, kind, rest = noise
    expected = {0x20: 0x60, 0x40: 0x40, 0x60: 0x00}[request[0] & 0xE0]
    if way == "of another kind" and kind not in (expected, 0x80):
        return bytes([kind]) + request[1:4] + rest[:4]
    if way == "with the wrong toggle" and expected == 0x00:
        return bytes([0x10 - (request[0] & 0x10)]) + b"\xff" * 7
    if way == "of another length":
        return (bytes([expected]) + request[1:])[: kind >> 5]
    # About an object that was not requested.
    return bytes([expected or 0x80]) + b"\xff\xff\xff" + rest[:4]


def endless(drawn):
    """The drawn events, then only undisturbed ones."""
    yield from drawn
    while True:
        yield 0, "", ("", 0, bytes(4))


KEYS = st.sampled_from([*LENGTHS, (0x1000, 7), (0x1018, 0)])
NOISE = st.tuples(
    st.sampled_from(["", "of another kind", "with the wrong toggle", "of another length"]),
    st.sampled_from(range(0, 0x100, 0x20)),
    st.binary(min_size=4, max_size=4),
)
LOSSES = st.sampled_from([*[""] * 6, "request", "answer", "cancelled"])
FATES = st.lists(st.tuples(st.integers(0, LATEST), LOSSES, NOISE), max_size=60)


@settings(derandomize=True, database=None, max_examples=200)
@given(st.lists(st.tuples(KEYS, st.booleans(), st.booleans()), max_size=12), FATES)
def test_answer_to_an_earlier_request_is_never_taken(transfers, drawn):
    line, fates = Line(), endless(drawn)
    for key, writes, refuses in transfers:
        line.objects.refuses = refuses
        before = line.objects.serial
        data = struct.pack("<H", before)
        line.requests = 0
        effects = line.client.download(key, data) if writes else line.client.upload(key)
        result = line.run(effects, fates)
        # Each try costs at most a probe, an initiation and its segments.
        assert line.requests <= TRIES + 1 + TRIES * (1 + LONGEST // 7 + 1)
        match result:
            case Done(value) if writes:
                assert value == b""
                assert any(serial > before and at == [key, data] for serial, *at in line.objects.writes)
            case Done(value):
                assert len(value) == LENGTHS[key]
                assert int.from_bytes(value[:2], "little") > before
            case Refused(code):
                assert code - 0x0800_0000 > before
            case Failed(silent=silent):
                assert silent
            case None:
                assert line.client.on_cancelled() == []


# -- single answers


def begun(key=KEY):
    client = SdoClient()
    return client, client.upload(key)


def about(command, key=KEY, rest=b""):
    return struct.pack("<BHB", command, *key) + rest.ljust(4, b"\0")


ABORTED = 0x05040000
SEGMENT = Send(b"\x60".ljust(8, b"\0"), ANSWER)


def refused(code, why, key=KEY):
    return [Send(about(ABORT, key, code.to_bytes(4, "little"))), Failed(why)]


@pytest.mark.parametrize(
    ("command", "data"),
    [
        (0x43, b"\1\2\3\4"),
        (0x42, b"\1\2\3\4"),
        (0x4E, b"\1\2\3\4"),
        (0x47, b"\1\2\3"),
        (0x4B, b"\1\2"),
        (0x4F, b"\1"),
    ],
)
def test_expedited_answer_has_its_stated_length_or_four_bytes(command, data):
    client, sent = begun()
    assert sent == [Send(about(0x40), ANSWER)]
    assert client.on_response(about(command, rest=b"\1\2\3\4")) == [Done(data)]
    assert client.on_response(about(command, rest=b"\1\2\3\4")) == []


@pytest.mark.parametrize(
    ("data", "command"), [(b"\1", 0x2F), (b"\1\2", 0x2B), (b"\1\2\3", 0x27), (b"\1\2\3\4", 0x23)]
)
def test_expedited_download_states_its_length(data, command):
    client = SdoClient()
    assert client.download(KEY, data) == [Send(about(command, rest=data), ANSWER)]
    assert client.on_response(about(0x60)) == [Done()]


def test_segmented_upload_with_and_without_stated_size():
    for size in (9, 0):
        client, _ = begun()
        rest = size.to_bytes(4, "little") if size else b"\xff" * 4
        assert client.on_response(about(0x41 if size else 0x40, rest=rest)) == [SEGMENT]
        assert client.on_response(b"\x00abcdefg") == [Send(b"\x70".ljust(8, b"\0"), ANSWER)]
        assert client.on_response(b"\x00abcdefg") == []  # the same segment again
        assert client.on_response(b"\x1bhi\0\0\0\0\0") == [Done(b"abcdefghi")]


def test_oversized_or_wrong_length_transfer_is_refused_without_retry():
    client, _ = begun()
    long = about(0x41, rest=(LONGEST + 1).to_bytes(4, "little"))
    assert client.on_response(long) == refused(0x05040005, "received 65 bytes, more than 64")
    client.upload(KEY)
    client.on_response(about(0x40))
    for n in range(LONGEST // 7):
        assert len(client.on_response(bytes([0x10 * (n % 2)]) + bytes(7))) == 1
    assert client.on_response(b"\x10" + bytes(7)) == refused(0x05040005, "received more than 64 bytes")
    client.upload(KEY)
    client.on_response(about(0x41, rest=b"\5"))
    assert client.on_response(b"\x0e" + bytes(7)) == refused(0x06070010, "received a segment without bytes")
    client.upload(KEY)
    client.on_response(about(0x41, rest=b"\5"))
    assert client.on_response(b"\x01" + bytes(7)) == [Failed("received 7 bytes of 5")]


def test_abort_counts_only_for_the_requested_object():
    client, _ = begun()
    assert client.on_response(about(ABORT, OTHER, b"\0\0\2\6")) == []
    assert client.on_response(about(ABORT, KEY, b"\0\0\2\6")) == [Refused(0x06020000)]
    assert client.on_response(about(ABORT, KEY, b"\0\0\2\6")) == []
    client.upload(KEY)
    client.on_response(about(0x41, rest=b"\x09"))
    assert client.on_response(about(ABORT, OTHER, b"\0\0\2\6")) == []
    assert client.on_response(about(ABORT, KEY, b"\0\0\2\6")) == [Refused(0x06020000)]


def test_silence_fails_after_its_tries_and_a_probe_ends_the_doubt():
    client, sent = begun()
    given_up = Send(about(ABORT, rest=ABORTED.to_bytes(4, "little")))
    assert [client.on_timeout() for _ in range(TRIES)] == [
        [given_up, *sent],
        [given_up, *sent],
        [given_up, Failed("no answer within 0.3 s, 3 times", silent=True)],
    ]
    assert client.upload(OTHER) == [Send(about(0x40, OTHER), ANSWER)]
    assert client.on_response(about(0x43, OTHER)) == [Done(bytes(4))]
    # Answers that may arrive late.
    probe = Send(about(0x40, PROBES[0]), ANSWER)
    assert client.download(KEY, b"\1") == [probe]
    for late in (about(0x43), about(0x60), about(ABORT), about(0x60, PROBES[0])):
        assert client.on_response(late) == []
    assert client.on_response(about(ABORT, PROBES[0], b"\x11\0\x09\6")) == [
        Send(about(0x2F, rest=b"\1"), ANSWER)
    ]
    assert client.on_response(about(0x60)) == [Done()]
    assert client.upload(KEY) == sent


def test_unanswered_probe_is_followed_by_another_probe():
    client, _ = begun(PROBES[0])
    for _ in range(TRIES):
        client.on_timeout()
    requests = []
    for _ in range(10):
        effects = client.upload(PROBES[0])
        for _ in range(TRIES):
            requests.append(effects[-1].data[1:4])
            effects = client.on_timeout()
    probes = [about(0, key)[1:4] for key in PROBES[1:]]
    assert requests == probes * 2
