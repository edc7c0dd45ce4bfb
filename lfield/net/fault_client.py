"""Client of the fault-injection sockets of running fakes: Unix sockets, one JSON line each way (`lfield sim
fault`)."""

from __future__ import annotations

import json
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lfield.errors import AddressError

#: Seconds to wait for an answer, and its maximum size in bytes.
ANSWER_TIMEOUT, MAX_ANSWER = 10.0, 1 << 20


def send_fault_command(path: Path, settings: Sequence[str]) -> dict[str, Any]:
    """Set faults (`NAME[@DEVICE]=VALUE`) of the simulated device at a socket; without faults, query it.

    The answer has kind, endpoint, devices, and faults or error. Raises AddressError when there is no answer.
    """
    try:
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(ANSWER_TIMEOUT)
            link.connect(str(path))
            link.sendall(json.dumps({"set": list(settings)}).encode() + b"\n")
            answer = json.loads(_line(link))
    except OSError as error:
        raise AddressError(str(path), error.strerror or str(error)) from None
    except (ValueError, RecursionError):
        raise AddressError(str(path), "not the socket of a simulated device: invalid answer") from None
    if not isinstance(answer, dict):
        raise AddressError(str(path), "not the socket of a simulated device: invalid answer")
    return answer


def is_stale_socket(path: Path) -> bool:
    """Whether a socket is stale because its process was killed."""
    try:
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(ANSWER_TIMEOUT)
            link.connect(str(path))
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
