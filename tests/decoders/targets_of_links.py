"""Data from a link: streams of frames, handshakes, messages, transfers, and their effects on a host."""

from __future__ import annotations

import random
import struct
import zlib
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from typing import Any

import msgspec
from decoder_missions import HOSTS, mission
from decoder_target import Target

from lfield.authority.identity import NO_RIGHTS, Identity
from lfield.clock import ManualClock
from lfield.errors import HandshakeError, LfieldError, WireError
from lfield.host.context import HostContext
from lfield.host.core import HostCore
from lfield.host.events.event_recorder import EventRecorder
from lfield.net.coding.link_compression import LinkCompression
from lfield.net.coding.transfer_history import Delta, TransferHistory
from lfield.net.framed_link import FramedLink
from lfield.net.handshake import Handshake
from lfield.replication.membership.overlay import Overlay
from lfield.replication.transfer.effects import Send, SendTransfer
from lfield.wire import codec
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.framing import HEADER_SIZE, Buffer, frame
from lfield.wire.messages import Control, HandshakeRefused, Hello, IncompatibleHello, Message, Role

pack = msgspec.msgpack.encode
unpack = msgspec.msgpack.decode
#: Valid names of the mission, and the tags of messages.
TOKENS = (
    *("alpha", "bravo", "charlie", "bell", "horn", "tom", "ann", "idle", "near", "far", "host", "observer"),
    *("RUN", "EXITED", "MOVED", "FROZEN", "PREPARED", "IN DOUBT", "PARKED"),
    *("done", "died", "lost", "superseded", "measured", *range(40)),
)


#: The first bytes of every Hello.
HELLO_START = codec.MAGIC + struct.pack(">H", codec.PROTOCOL)
#: The first byte of an input: a wrong checksum of block or header, or raw bytes.
OF_BLOCK, OF_HEADER, AS_IT_IS = 1, 2, 3
#: The authenticated peer.
BRAVO = Identity("host", "bravo", NO_RIGHTS)


class NoObservations:
    """The observations that are available to a host without devices."""

    down_since: dict[str, float] = {}

    def last_contact_at(self, host: str) -> None:
        """Return None: no message was received."""

    def round_trip(self, host: str) -> None:
        """Return None: no round trip was measured."""

    answers_within = round_trip

    def last(self, device: str, quantity: str) -> None:
        """Return None: there is no telemetry."""

    def unavailability(self, device: str) -> None:
        """Return None: there is no device."""


def host(name: str, clock: ManualClock, life: int) -> HostCore:
    """A started host of the mission with its resources and coordinators."""
    loaded = mission()
    neighbours = Overlay(loaded.team.hosts, loaded.team.number(name), is_full_mesh=True)
    core = HostCore(
        HostContext(
            loaded,
            name,
            life,
            clock,
            NoObservations(),
            random.Random(1),
            10.0,
            neighbours,
            EventRecorder(clock),
        )
    )
    core.start_resources(first=True)
    core.run()
    return core


def sealed(body: bytes, before: bytes = b"") -> bytes:
    """The payload of a message or Hello with a correct checksum."""
    check = zlib.crc32(body, len(before) + 4 + len(body))
    return before + struct.pack(">I", check) + body


# -- one message ----------------------------------------------------------------------------------------


def frame_of(data: bytes) -> tuple[int, bytes] | None:
    """The kind and payload of the frame of a tree [kind, body], or None for another tree.

    A tree as body is packed with a correct checksum; bytes are the raw payload.
    """
    try:
        kind, body = unpack(data)
    except (msgspec.MsgspecError, ValueError, RecursionError, TypeError):
        return None
    if not isinstance(kind, int):
        return None
    if isinstance(body, bytes):
        return kind, body
    return kind, sealed(pack(body), HELLO_START if kind == codec.HELLO else b"")


def decode_control(data: bytes) -> None:
    """Decode one message of a peer with the role of host or observer."""
    if (frame := frame_of(data)) is None:
        return
    try:
        message = codec.decode(*frame)
        if not isinstance(message, Hello | IncompatibleHello):
            codec.encode(message)
    except WireError:
        return
    for role in ("host", "observer"):
        with suppress(WireError, HandshakeError):
            handshake_with(role).admit(message)


def decode_hello(data: bytes) -> None:
    """Decode the first message of a peer, as a host and as a command."""
    if (frame := frame_of(data)) is None:
        return
    own = hello_of("alpha")
    for role in ("host", "observer"):
        try:
            message = codec.decode(*frame)
            here = msgspec.structs.replace(own, role=role)
            Handshake(here, BRAVO, hosts=HOSTS, linked={"charlie": 5}).receive(message)
        except (WireError, HandshakeError) as error:
            str(error)


@cache
def handshake_with(role: Role) -> Handshake:
    """A completed handshake with bravo in this role."""
    handshake = Handshake(hello_of("alpha"), BRAVO, hosts=HOSTS)
    handshake.receive(msgspec.structs.replace(hello_of("bravo"), role=role))
    return handshake


def decode_transfer(data: bytes) -> None:
    """Decode a transfer; the input is the wrong checksum, the length of the header, header, block."""
    wrong, size = (data + b"\0\0")[:2]
    head, block = data[2 : 2 + size], data[2 + size :]
    start = struct.pack(">IH", zlib.adler32(block) ^ (wrong == OF_BLOCK), len(head)) + head
    check = zlib.crc32(start, 4 + len(start) + len(block)) ^ (wrong == OF_HEADER)
    with suppress(WireError):
        codec.decode_transfer(data[1:] if wrong == AS_IT_IS else struct.pack(">I", check) + start + block)


def decode_compact(data: bytes) -> None:
    """Decode a compressed message with a correct checksum, or a delta of a known transfer."""
    (header, block), *_ = transfers()
    if data[:1] == b"\0":
        with suppress(WireError):
            codec.decode_compressed(sealed(data[1:]), partial(LinkCompression().decode, longest=4096))
        return
    history = TransferHistory()
    history.keep(header.agent, codec.encode_transfer(header, block)[HEADER_SIZE:] + block, is_sent=False)
    with suppress(WireError):
        delta = history.decode(memoryview(data)[1:])
        if isinstance(delta, Delta) and delta.size <= 1 << 16:
            assert len(delta.expand()) == delta.size
            delta.leading_bytes()


class LinkRecorder:
    """Records the messages of a link."""

    def __init__(self) -> None:
        self.messages: list[object] = []

    def on_message(self, link: FramedLink, message: Message) -> None:
        """Record a message; a Hello sets the role, a refusal closes the link."""
        self.messages.append(message)
        if isinstance(message, Hello):
            link.accept_role(message.role)
        elif isinstance(message, HandshakeRefused):
            link.close()

    def on_transfer(self, link: FramedLink, header: Transfer, block: memoryview) -> None:
        """Record a coordinator."""
        self.messages.append(bytes(block))

    def on_oversize(self, link: FramedLink, header: Transfer, size: int) -> None:
        """Record the size of an oversized coordinator."""
        self.messages.append(size)

    def on_closed(self, link: FramedLink, error: LfieldError | None) -> None:
        """Record the end of the link."""
        self.messages.append(str(error))


class Pipe(FramedLink):
    """A link with the fuzzer as its peer."""

    def write(self, data: Buffer) -> None:
        """Ignore: the link only sends requests for whole transfers."""

    def close(self) -> None:
        """Mark the link as closed."""
        self.closed = True


def decode_stream(data: bytes) -> None:
    """Feed bytes of a link in pieces of the size in the first byte, in one piece, and message by message.

    All three ways must give the same messages. The third is that of unauthenticated peers.
    """
    size, recorded = (data[0] if data else 0) + 1, []
    for step, is_guest in ((size, False), (len(data) + 1, False), (size, True)):
        link, recorder = Pipe("peer", 4096), LinkRecorder()
        link.handler = recorder
        for at in range(1, len(data), step):
            if link.closed:
                break
            piece = data[at : at + step]
            if is_guest:
                deque(link.deliver_pending(piece), maxlen=0)
            else:
                link.received(piece)
        link.on_eof(None)
        recorded.append(recorder.messages)
    same = recorded[0][:-1] == recorded[1][:-1] == recorded[2][:-1]
    assert same, "received messages depend on the split of the bytes"


# -- a whole host ---------------------------------------------------------------------------------------


def decode_events(data: bytes) -> None:
    """Apply events of a linked peer to a host; the input is a list of [kind, value]."""
    try:
        events = unpack(data)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return
    clock = ManualClock()
    core = host("alpha", clock, 7)
    core.start_coordinators(first=True)
    core.on_linked(hello_of("bravo"))
    for event in events[:60] if isinstance(events, list) else ():
        apply_event(core, clock, event)
        for _ in range(8):
            pause = core.run()
            effects = core.drain_effects()
            assert_no_bug_in_lfield(effects)
            for effect in effects:
                if hasattr(effect, "message"):
                    codec.encode(effect.message)
            if pause != 0.0:
                break
    core.hello()


def assert_no_bug_in_lfield(effects: Sequence[object]) -> None:
    """Assert that no agent ended by a bug in lfield."""
    for effect in effects:
        assert "bug in lfield" not in str(getattr(effect, "text", "")), effect


def apply_event(core: HostCore, clock: ManualClock, event: Any) -> None:
    """Apply one event; ignore values that are no event."""
    if not (isinstance(event, list) and len(event) == 2):
        return
    what, value = event
    try:
        if what == 0:
            hello = msgspec.convert(value, Hello)
            Handshake(core.hello(), BRAVO, hosts=HOSTS).receive(hello)
            if hello.role == "host":
                core.on_linked(hello)
        elif what == 1:
            message: Control = codec.decode(codec.CONTROL, sealed(pack(value)))  # type: ignore[assignment]
            core.on_message("bravo", message)
        elif what == 2 and isinstance(value, list) and len(value) == 2 and isinstance(value[1], bytes):
            header = msgspec.convert(value[0], Transfer)
            core.on_transfer("bravo", header, memoryview(value[1]))
        elif what == 3:
            core.on_unlinked("bravo", quietly=bool(value))
        elif what == 4 and isinstance(value, int | float) and 0 < value < 1e6:
            clock.advance(value)
        elif what == 6:
            core.on_oversize("bravo", msgspec.convert(value, Transfer), 1 << 30)
        elif what == 7:
            operator_messages(core, value)
    except (WireError, HandshakeError, msgspec.ValidationError):
        return


def operator_messages(core: HostCore, value: Any) -> None:
    """Apply the request of an observer to the core."""
    message = codec.decode(codec.CONTROL, sealed(pack(value)))
    match type(message).__name__:
        case "ForgetRequest":
            core.forget(message.agent)
        case "RecoverRequest":
            codec.encode(core.recover(message))
        case "Pause":
            core.set_paused(on=not message.lift)
        case "EmergencyStop":
            core.set_emergency_stop("" if message.lift else message.reason)


# -- a block --------------------------------------------------------------------------------------------


def decode_block(data: bytes) -> None:
    """Decode the block of a coordinator from another host: it is refused or runs."""
    clock = ManualClock()
    core = host("alpha", clock, 7)
    core.on_linked(hello_of("bravo"))
    header = msgspec.structs.replace(transfers()[0][0], size=len(data))
    core.on_transfer("bravo", header, memoryview(data))
    for _ in range(20):
        pause = core.run()
        effects = core.drain_effects()
        assert_no_bug_in_lfield(effects)
        clock.advance(pause or 0.0)


# -- seeds ----------------------------------------------------------------------------------------------


@cache
def hello_of(name: str) -> Hello:
    """The Hello of a host of the mission."""
    return host(name, ManualClock(), {"alpha": 7, "bravo": 3}.get(name, 9)).hello()


@cache
def transfers() -> Sequence[tuple[Transfer, bytes]]:
    """Coordinators that bravo sends to alpha, at several points of their missions."""
    found: list[tuple[Transfer, bytes]] = []
    clock = ManualClock()
    cores = {"alpha": host("alpha", clock, 7), "bravo": host("bravo", clock, 3)}
    for core, other in ((cores["alpha"], cores["bravo"]), (cores["bravo"], cores["alpha"])):
        core.start_coordinators(first=True)
        core.on_linked(other.hello())
    for _ in range(2000):
        pauses = [core.run() for core in cores.values()]
        for name, core in cores.items():
            for effect in core.drain_effects():
                to = getattr(effect, "host", "")
                if isinstance(effect, SendTransfer) and to in cores:
                    found += [(effect.header, bytes(effect.block))] if to == "alpha" else []
                    cores[to].on_transfer(name, effect.header, memoryview(bytes(effect.block)))
                elif isinstance(effect, Send) and to in cores:
                    cores[to].on_message(name, effect.message)
        clock.advance(min((pause for pause in pauses if pause is not None), default=0.01) + 0.001)
    return found[:: max(1, len(found) // 12)]


def messages() -> list[Any]:
    """A message of every type as a msgpack tree, with a value in every field."""
    types = Control.__args__  # type: ignore[attr-defined]
    return [unpack(pack(example(kind))) for kind in types]


def example(kind: type) -> Any:
    """A struct with a plain value in every field."""
    return kind(*(_plain(f.type) for f in msgspec.inspect.type_info(kind).fields))


def _plain(kind: Any) -> Any:
    i = msgspec.inspect
    match kind:
        case i.IntType():
            return 3
        case i.FloatType():
            return 1.5
        case i.BoolType():
            return True
        case i.StrType():
            return "tom"
        case i.BytesType():
            return mission().program.digest
        case i.NoneType():
            return None
        case i.LiteralType():
            return sorted(kind.values)[-1]
        case i.ListType() | i.VarTupleType() | i.SetType():
            return [_plain(kind.item_type)]
        case i.TupleType():
            return tuple(map(_plain, kind.item_types))
        case i.DictType():
            return {_plain(kind.key_type): _plain(kind.value_type)}
        case i.UnionType():
            return _plain(kind.types[-1] if isinstance(kind.types[-1], i.StructType) else kind.types[0])
        case i.StructType():
            return kind.cls(*(_plain(f.type) for f in kind.fields))
    raise AssertionError(kind)


def _event_seeds() -> Sequence[bytes]:
    hello = [0, unpack(pack(hello_of("bravo")))]
    header, block = transfers()[0]
    arrival = [2, [unpack(pack(header)), block]]
    events = [[1, message] for message in messages()]
    quiet = [pack([event]) for event in events] + [pack([event, [4, 0.5], event]) for event in events]
    busy = [pack([arrival, event, [4, 11.0], hello]) for event in events]
    people = [pack([[7, message], [4, 1.0]]) for message in messages()]
    rest = pack([hello, [6, arrival[1][0]], [3, 0], [4, 30.0], hello])
    return [*quiet, *busy, *people, rest, pack([hello, *events])]


@cache
def payloads() -> Mapping[int, Sequence[bytes]]:
    """Valid payloads of a peer by frame kind; every kind of the wire format must be listed."""
    header, block = transfers()[0]
    controls = [codec.encode(example(kind)) for kind in Control.__args__]  # type: ignore[attr-defined]
    hellos = [
        codec.encode(hello_of("bravo")),
        *(frame(codec.HELLO, start) for start in (b"lfld\0\6", b"lfl")),
    ]
    refusals = [
        codec.encode(HandshakeRefused("no")),
        frame(codec.REFUSE, b"\xff no"),
        frame(codec.REFUSE, b""),
    ]
    found = {
        codec.HELLO: hellos,
        codec.REFUSE: refusals,
        codec.CONTROL: controls,
        codec.TRANSFER: [codec.encode_transfer(header, block) + block],
        codec.PART: [
            frame(codec.PART, part) for part in (controls[0], controls[0][:7], controls[0][7:], b"")
        ],
        codec.TRANSFER_DELTA: _deltas(),
        codec.COMPRESSED: [
            codec.compress_frame(codec.encode(example(kind)), LinkCompression().encode)
            for kind in Control.__args__  # type: ignore[attr-defined]
        ],
    }
    allowed = codec.limits("host", 1).keys() | codec.HANDSHAKE_LIMITS.keys()
    assert found.keys() == allowed, "a frame kind has no seeds"
    return {kind: [data[HEADER_SIZE:] for data in sent] for kind, sent in found.items()}


def _deltas() -> Sequence[bytes]:
    """Deltas of the same hop, a changed and a long one, one with an unknown reference, and damaged ones."""
    (header, block), *_ = transfers()
    encoded = codec.encode_transfer(header, block)[HEADER_SIZE:] + block
    frames = []
    for changed in (block, block[:-1] + b"?", bytes(6000)):
        history = TransferHistory()
        history.keep(header.agent, encoded, is_sent=False)
        named = msgspec.structs.replace(header, size=len(changed))
        sent = codec.encode_transfer(named, changed)[HEADER_SIZE:] + changed
        frames.append(history.encode(header.agent, frame(codec.TRANSFER, sent), is_fast=False))
    other = TransferHistory()
    other.keep(header.agent, block, is_sent=False)
    frames.append(other.encode(header.agent, frame(codec.TRANSFER, encoded), is_fast=False))
    return [*frames, frame(codec.TRANSFER_DELTA, frames[0][HEADER_SIZE:-3]), frame(codec.TRANSFER_DELTA, b"")]


def _stream_seeds() -> Sequence[bytes]:
    hello = codec.encode(hello_of("bravo"))
    observer = codec.encode(msgspec.structs.replace(hello_of("bravo"), role="observer"))
    sent = {kind: [frame(kind, payload) for payload in all_of] for kind, all_of in payloads().items()}
    alone = [each for all_of in sent.values() for each in all_of[:3]]
    streams = [before + each for before in (b"", hello, observer) for each in alone]
    everything = b"".join(each for all_of in sent.values() for each in all_of)
    large = codec.encode_transfer(transfers()[0][0], bytes(6000)) + bytes(6000)
    unknown_kind = frame(max(sent) + 1, b"")
    hop = sent[codec.TRANSFER][0]
    streams += [hello + hop + delta for delta in sent[codec.TRANSFER_DELTA]]
    streams += [hello, hello + everything, hello + unknown_kind, unknown_kind[:-1]]
    pieces = [bytes([size]) + data for data in streams for size in (HEADER_SIZE, 250)]
    return [*pieces, bytes([250]) + hello + large + hello, bytes([250]) + observer + large, b"\0" + hello]


def _message_seeds(trees: Mapping[int, Sequence[Any]]) -> Sequence[bytes]:
    """Messages as trees, and every kind of frame as bytes, complete and truncated."""
    plain = [[kind, tree] for kind, all_of in trees.items() for tree in all_of]
    sent = [[kind, payload] for kind, all_of in payloads().items() for payload in all_of[:3]]
    cut = [[kind, payload[:n]] for kind, payload in sent for n in (0, 3, 9, len(payload) - 1)]
    return [pack(seed) for seed in (*plain, *sent, *cut)]


def _greeting_seeds() -> Sequence[bytes]:
    hellos = [unpack(pack(hello_of(name))) for name in ("bravo", "charlie")]
    return [*_message_seeds({codec.HELLO: hellos}), pack([codec.HELLO, b"lflf" + bytes(2)])]


def _control_seeds() -> Sequence[bytes]:
    return _message_seeds({codec.CONTROL: messages(), codec.HELLO: [unpack(pack(hello_of("bravo")))]})


def _transfer_seeds() -> Sequence[bytes]:
    heads = [(pack(header), block) for header, block in transfers()[:3]]
    blocks = [bytes([len(head)]) + head + block for head, block in heads]
    short = [*(each[:-1] for each in blocks[:1]), b"\xff\xff"]
    wrong = [bytes([how]) + each for how in (OF_BLOCK, OF_HEADER, AS_IT_IS) for each in blocks[:1]]
    return [
        *(b"\0" + each for each in (*blocks, *short)),
        *wrong,
        bytes([AS_IT_IS]) + payloads()[codec.TRANSFER][0],
        bytes([AS_IT_IS]) + bytes(8) + b"\xff" * 900,
    ]


def _compact_seeds() -> Sequence[bytes]:
    deltas = [b"\1" + payload for payload in payloads()[codec.TRANSFER_DELTA]]
    unnamed = bytearray(deltas[0])
    unnamed[15] = 0xFF
    long = struct.pack(">I", 1 << 15) + deltas[0][5:]
    return [
        *deltas,
        bytes(unnamed),
        b"\1" + long,
        *(b"\0" + payload[4:] for payload in payloads()[codec.COMPRESSED]),
        b"\0" + LinkCompression().encode(bytes(1 << 16)),
        b"\0\xff\xff",
    ]


TARGETS = (
    Target("stream", _stream_seeds, decode_stream, tokens=(b"lfld",)),
    Target("greeting", _greeting_seeds, decode_hello, True, TOKENS),
    Target("control", _control_seeds, decode_control, True, TOKENS),
    Target("transfer", _transfer_seeds, decode_transfer),
    Target("compact", _compact_seeds, decode_compact),
    Target("host", _event_seeds, decode_events, True, TOKENS),
    Target("block", lambda: [block for _, block in transfers()], decode_block),
)
