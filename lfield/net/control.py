"""Talks to the fault doors of running fakes: Unix sockets, a line of JSON each way (`lfield sim fault`)."""

from __future__ import annotations

import json
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lfield.errors import AddressError

#: Seconds a fake has for its answer, and the most it may say, in bytes.
BOUND, MAX_ANSWER = 10.0, 1 << 20


def ask_fake(door: Path, settings: Sequence[str]) -> dict[str, Any]:
    """Set faults (`NAME[@DEVICE]=VALUE`) of the fake behind a socket, or with none only ask.

    Its answer: kind, endpoint, devices, and faults or error. Raises AddressError when nobody answers.
    """
    try:
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(BOUND)
            link.connect(str(door))
            link.sendall(json.dumps({"set": list(settings)}).encode() + b"\n")
            answer = json.loads(_line(link))
    except OSError as error:
        raise AddressError(str(door), error.strerror or str(error)) from None
    except (ValueError, RecursionError):
        raise AddressError(str(door), "this is no fake: its answer makes no sense") from None
    if not isinstance(answer, dict):
        raise AddressError(str(door), "this is no fake: its answer makes no sense")
    return answer


def is_abandoned(door: Path) -> bool:
    """Whether nobody will ever answer at a socket: whoever listened there was killed."""
    try:
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(BOUND)
            link.connect(str(door))
    except ConnectionRefusedError:
        return True
    except OSError:
        return False
    return False


def _line(link: socket.socket) -> bytes:
    data = b""
    while b"\n" not in data and len(data) < MAX_ANSWER:
        chunk = link.recv(1 << 16)
        if not chunk:
            break
        data += chunk
    return data
