"""Explanations of socket errors for the user."""

from __future__ import annotations

import errno
import os
import socket

_REASONS = {
    errno.EADDRINUSE: "the port is in use; stop the program that has it, or choose another port",
    errno.EADDRNOTAVAIL: "the address is not one of this machine; correct the deployment or map the host",
    errno.EACCES: "this user has no permission for the port; choose one above 1023",
    errno.EHOSTUNREACH: "no route to that host",
    errno.ENETUNREACH: "no route to that network",
    errno.ENODEV: "this machine has no such network interface now",
}


def describe(error: OSError | UnicodeError) -> str:
    """Explain a socket error to the user."""
    if isinstance(error, socket.gaierror) and error.errno == socket.EAI_AGAIN:
        return "the name server does not answer"
    if isinstance(error, socket.gaierror | UnicodeError):
        return "the name is not known; correct it, or say where the host is with --map NAME=ADDR:PORT"
    if error.errno in _REASONS:
        return _REASONS[error.errno]
    return os.strerror(error.errno) if error.errno else str(error)
