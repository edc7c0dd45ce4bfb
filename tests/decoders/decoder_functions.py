"""The functions that read what others send, by the targets that are there for them, line by line.

What no input reaches stands here with the reason. Of targets that are not here a whole machine, host or
driver reads what comes, or the readers of a language, whose rooms have tests of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield.authority import identity, reading, signature
from lfield.driver.serial.framing import Lines, Packets
from lfield.guard.messages import MessageReader
from lfield.journal.pages import page_of
from lfield.mission import bundle
from lfield.net.framed import FramedLink
from lfield.net.greeting import Greeting
from lfield.wire import codec
from lfield.wire.framing import FrameDecoder
from lfield_can.bus.socketcand import Socketcand
from lfield_dynamixel.bus.packets import Protocol1, Protocol2, split_fast

_MESSAGES = (codec.decode, codec._check, codec._strict)
READS: Mapping[str, Sequence[object]] = {
    "stream": (
        FrameDecoder,
        codec.frame_decoder,
        codec.limits,
        FramedLink.received,
        FramedLink.finished,
        FramedLink._oversize,
    ),
    "greeting": (*_MESSAGES, codec._decode_hello, Greeting.receive),
    "control": (*_MESSAGES, Greeting.admit),
    "transfer": (codec.decode_transfer, codec._split_transfer, codec._strict),
    "bundle-file": (bundle.contents, bundle._split),
    "page": (page_of,),
    "certificate": (reading.identity_in_der,),
    "revocations": (reading.revoked_in,),
    "names": (identity.identity_of,),
    "signature": (signature.signed,),
    "guard-in": (MessageReader,),
    "guard-out": (MessageReader,),
    "dynamixel": (Protocol1.reader, Protocol2.reader, split_fast),
    "socketcand": (Socketcand.data_received,),
    "serial": (Lines.feed, Packets.feed),
}
_BUG = "only a bug of ours gets there, and no input may"
_LARGE = "no input is so large"
#: By target: lines that no input reaches, each with the reason.
UNREACHED: Mapping[str, Mapping[str, str]] = {
    "stream": {
        "FramedLink.received: except Exception as error:": _BUG,
        "FramedLink.received: self.close()": _BUG,
        "FramedLink.received: unexpected(error)": _BUG,
    },
    "control": {
        'Greeting.admit: raise WireError(f"a {type(message).__name__} came before the greeting")': (
            "here all have greeted"
        ),
    },
    "bundle-file": {
        'contents: raise BundleError(f"it is larger than {MAX_SIZE >> 20} MiB")': _LARGE,
    },
    "page": {
        'page_of: raise PageError("it is not of the right kind") from None': "SQLite's columns have types",
    },
    "revocations": {'revoked_in: raise KeysError("the revocation list is too large")': _LARGE},
}
