"""Gives away all rights of this process but those of a `Reach`, for good: Landlock, and a filter of sockets.

https://docs.kernel.org/userspace-api/landlock.html. Both are asked for by number, as no library has to be
there. What a kernel does not know is left out: `strength` says what this one gives.
"""

from __future__ import annotations

import ctypes
import os
import platform
import stat
import struct
from collections.abc import Iterable
from contextlib import suppress

from lfield.guard.reach import Reach

#: Landlock's system calls, the same on all processors.
_CREATE, _ADD, _RESTRICT = 444, 445, 446
_VERSION, _PATH, _PORT = 1, 1, 2
#: Rights: to run and to read, to write; to remove and make in a folder; and those that came later, by ABI.
_EXECUTE, _WRITE, _READ, _TRUNCATE, _IOCTL = 1 << 0, 1 << 1, 1 << 2, 1 << 14, 1 << 15
_FOLDER = sum(1 << bit for bit in range(4, 13))
_LATER = {2: 1 << 13, 3: _TRUNCATE, 5: _IOCTL}
_OF_FILES = _EXECUTE | _WRITE | _READ | _TRUNCATE | _IOCTL
#: To listen and to call by TCP; signals that leave this process and its children.
_TCP, _CALL, _SIGNALS = 3, 2, 2

_NO_NEW_PRIVILEGES, _SECCOMP, _FILTER = 38, 22, 2
#: By processor: how the kernel calls it, and its number of socket().
_PROCESSORS = {"x86_64": (0xC000003E, 41), "aarch64": (0xC00000B7, 198), "armv7l": (0x40000028, 281)}
_IO_URING_SETUP = 425
#: Unix and CAN.
_FAMILIES = (1, 29)
_LOAD, _EQUAL, _AT_LEAST, _RETURN = 0x20, 0x15, 0x35, 0x06
_ALLOWED, _REFUSED = 0x7FFF0000, 0x00050000
_EPERM, _EAFNOSUPPORT, _ENOSYS = 1, 97, 38

_libc = ctypes.CDLL(None, use_errno=True)
_libc.syscall.restype = ctypes.c_long
_libc.prctl.argtypes = [ctypes.c_int, *[ctypes.c_ulong] * 4]


def abi() -> int:
    """The version of this kernel's Landlock, 0 for none."""
    return int(max(0, _libc.syscall(_CREATE, None, ctypes.c_size_t(0), ctypes.c_uint(_VERSION))))


def strength() -> tuple[str, str]:
    """What keeps a guard to its device on this kernel, in words, and what does not: '' for nothing."""
    version = abi()
    if not version:
        return "", "this kernel has no Landlock (5.13 has; see CONFIG_SECURITY_LANDLOCK and 'lsm=')"
    kept = ["files"] + ["TCP"] * (version >= 4) + ["devices"] * (version >= 5) + ["signals"] * (version >= 6)
    missing = ["TCP"] * (version < 4) + ["devices"] * (version < 5) + ["signals"] * (version < 6)
    if platform.machine() in _PROCESSORS:
        kept.append("sockets")
    else:
        missing.append("sockets")
    return ", ".join(kept), ", ".join(missing)


def confine(reach: Reach) -> None:
    """From here on this process, and whatever it starts, touches nothing else; as far as the kernel can.

    It must have no other threads yet: theirs would keep their rights. Raises OSError when the kernel could
    and does not.
    """
    _checked(_libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0))
    if version := abi():
        _landlock(reach, version)
    if not reach.internet and platform.machine() in _PROCESSORS:
        _filter_sockets(*_PROCESSORS[platform.machine()])


def _landlock(reach: Reach, version: int) -> None:
    handled = (
        _EXECUTE | _WRITE | _READ | _FOLDER | sum(bit for since, bit in _LATER.items() if version >= since)
    )
    network = _TCP if version >= 4 and reach.ports is not None else 0
    wanted = struct.pack("=QQQ", handled, network, _SIGNALS if version >= 6 else 0)
    size = 24 if version >= 6 else 16 if version >= 4 else 8
    rules = _checked(_libc.syscall(_CREATE, wanted, ctypes.c_size_t(size), ctypes.c_uint(0)))
    try:
        runs = _EXECUTE if reach.runs else 0
        _allow(rules, reach.reads, handled & (_READ | runs))
        _allow(rules, reach.writes, handled & (_OF_FILES & ~_EXECUTE))
        _allow(rules, reach.folders, handled & ~_EXECUTE)
        for port in reach.ports or () if network else ():
            _add(rules, _PORT, struct.pack("=QQ", _CALL, port))
        _checked(_libc.syscall(_RESTRICT, ctypes.c_int(rules), ctypes.c_uint(0)))
    finally:
        os.close(rules)


def _allow(rules: int, paths: Iterable[str], rights: int) -> None:
    """These rights for files, and for all in folders; what is not there has none to give."""
    for path in paths:
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
            try:
                folder = stat.S_ISDIR(os.fstat(descriptor).st_mode)
                _add(rules, _PATH, struct.pack("=Qi", rights if folder else rights & _OF_FILES, descriptor))
            finally:
                os.close(descriptor)


def _add(rules: int, kind: int, rule: bytes) -> None:
    _checked(_libc.syscall(_ADD, ctypes.c_int(rules), ctypes.c_int(kind), rule, ctypes.c_uint(0)))


def _filter_sockets(processor: int, socket: int) -> None:
    """No socket of another family than Unix and CAN; Landlock knows only TCP. io_uring would go around it."""
    allowed, refused = (_RETURN, 0, 0, _ALLOWED), (_RETURN, 0, 0, _REFUSED | _EAFNOSUPPORT)
    families = [(_EQUAL, len(_FAMILIES) - at, 0, family) for at, family in enumerate(_FAMILIES)]
    program = [
        (_LOAD, 0, 0, 4),
        (_EQUAL, 1, 0, processor),
        (_RETURN, 0, 0, _REFUSED | _ENOSYS),
        (_LOAD, 0, 0, 0),
        # Another way to call the same processor (x32) has other numbers.
        (_AT_LEAST, 0, 1, 1 << 30),
        (_RETURN, 0, 0, _REFUSED | _ENOSYS),
        (_EQUAL, 0, 1, _IO_URING_SETUP),
        (_RETURN, 0, 0, _REFUSED | _EPERM),
        (_EQUAL, 1, 0, socket),
        allowed,
        (_LOAD, 0, 0, 16),
        *families,
        refused,
        allowed,
    ]
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *line) for line in program))
    told = ctypes.create_string_buffer(struct.pack("@HP", len(program), ctypes.addressof(code)))
    _checked(_libc.prctl(_SECCOMP, _FILTER, ctypes.addressof(told), 0, 0))


def _checked(result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result
