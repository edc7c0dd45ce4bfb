"""Coverage of the functions that read external data, by target: lines that no input reaches.

Tracing covers only calls, and lines in these functions, so that it takes little time. The other targets
feed a whole machine, host or driver, or the parsers of a language, which have tests in other folders.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator, Mapping, Sequence
from inspect import isclass
from linecache import getline
from types import CodeType, FrameType
from typing import Any

from decoder_corpus import corpus_of
from decoder_mutations import mutated
from decoder_target import Target

from lfield.authority import bundle_signature, certificate_reader, identity
from lfield.driver.serial.serial_framing import Lines, Packets
from lfield.guard.messages import MessageReader
from lfield.journal.records import decode_record
from lfield.mission import bundle
from lfield.net.coding.delta import expand_delta
from lfield.net.coding.link_compression import LinkCompression
from lfield.net.coding.transfer_history import TransferHistory
from lfield.net.framed_link import FramedLink
from lfield.net.handshake import Handshake
from lfield.wire import codec
from lfield.wire.framing import FrameDecoder
from lfield_can.bus.socketcand import Socketcand
from lfield_dynamixel.bus.packets import Protocol1, Protocol2, split_fast

_MESSAGES = (codec.decode, codec._verify_checksum, codec._strict)
READS: Mapping[str, Sequence[object]] = {
    "stream": (
        FrameDecoder,
        codec.frame_decoder,
        codec.limits,
        FramedLink.received,
        FramedLink.on_eof,
        FramedLink._oversize,
        FramedLink._on_delta,
    ),
    "compact": (TransferHistory.decode, expand_delta, LinkCompression.decode),
    "greeting": (*_MESSAGES, codec._decode_hello, Handshake.receive),
    "control": (*_MESSAGES, Handshake.admit),
    "transfer": (codec.decode_transfer, codec._split_transfer),
    "bundle-file": (bundle.contents, bundle._split),
    "page": (decode_record,),
    "certificate": (certificate_reader.identity_in_der,),
    "revocations": (certificate_reader.revoked_in,),
    "names": (identity.identity_of,),
    "signature": (bundle_signature.verify_bundle,),
    "guard-in": (MessageReader,),
    "guard-out": (MessageReader,),
    "dynamixel": (Protocol1.reader, Protocol2.reader, split_fast),
    "socketcand": (Socketcand.data_received,),
    "serial": (Lines.feed, Packets.feed),
}
_BUG = "only a bug of ours gets there, and no input may"
_LARGE = "no input is so large"
#: Lines that no input reaches, with the reason, by target.
UNREACHED: Mapping[str, Mapping[str, str]] = {
    "stream": {
        "FramedLink._on_delta: self._weigh(delta.agent)": "only a member over its budget gets no answers",
        "FramedLink._oversize: self._weigh(header.agent)": "only a member over its budget gets no answers",
        "FrameDecoder.reset_skipped: self.skipped = 0": "called by `withhold`, not by a reader",
    },
    "control": {
        'Handshake.admit: raise WireError(f"received {type(message).__name__} before the handshake")': (
            "here all have greeted"
        ),
    },
    "bundle-file": {
        'contents: raise BundleError(f"it is larger than {MAX_SIZE >> 20} MiB")': _LARGE,
    },
    "page": {
        'decode_record: raise RecordError("it is not of the right kind") from None': (
            "SQLite's columns have types"
        ),
    },
    "revocations": {'revoked_in: raise KeysError("the revocation list is too large")': _LARGE},
}

#: Number of mutations of each seed.
INPUTS = 200


def codes_of(thing: Any) -> Iterator[CodeType]:
    """The code of a function with its nested functions, or of the methods of a class."""
    if isclass(thing):
        for inner in vars(thing).values():
            if not isclass(inner):
                yield from codes_of(inner)
        return
    for held in ("fget", "func", "__func__", "__wrapped__", "__code__"):
        thing = getattr(thing, held, thing)
    if isinstance(thing, CodeType):
        yield thing
        for constant in thing.co_consts:
            yield from codes_of(constant)


def unreached(target: Target, functions: Sequence[object]) -> set[str]:
    """The text of the lines of these functions that no seed, stored input or mutation has reached."""
    codes = {code for thing in functions for code in codes_of(thing)}
    ran: set[tuple[CodeType, int]] = set()

    def line(frame: FrameType, event: str, argument: object) -> Any:
        ran.add((frame.f_code, frame.f_lineno))
        return line

    def call(frame: FrameType, event: str, argument: object) -> Any:
        return line if frame.f_code in codes else None

    known, rng = [*target.good, *corpus_of(target.name)], random.Random(target.name)
    made = (mutated(target, rng.choice(known), rng, rng.choice(known)) for _ in range(INPUTS // target.share))
    before = sys.gettrace()
    sys.settrace(call)
    try:
        for data in (*known, *made):
            target.decode(data)
    finally:
        sys.settrace(before)
    return {_text(code, number) for code in codes for number in _lines(code) if (code, number) not in ran}


def _lines(code: CodeType) -> set[int]:
    lines = {number for _, _, number in code.co_lines() if number}
    return lines - {code.co_firstlineno} if code.co_name != "<lambda>" else set()


def _text(code: CodeType, number: int) -> str:
    return f"{code.co_qualname}: {getline(code.co_filename, number).strip()}"
