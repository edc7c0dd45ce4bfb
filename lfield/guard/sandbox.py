"""Sandbox of a guard: Landlock and a seccomp filter for sockets, irrevocable.

https://docs.kernel.org/userspace-api/landlock.html. System calls are made by number, without a library.
Features that the kernel does not have are omitted: `describe_sandbox` lists the enforced ones.
"""

from __future__ import annotations

import ctypes
import os
import platform
import stat
import struct
from collections.abc import Iterable
from contextlib import suppress

from lfield.guard.sandbox_policy import SandboxPolicy

#: Landlock's system calls, the same on all processors.
_CREATE, _ADD, _RESTRICT = 444, 445, 446
_VERSION, _PATH, _PORT = 1, 1, 2
#: Access rights: execute and read, write; remove and create in a folder; and those of later ABI versions.
_EXECUTE, _WRITE, _READ, _TRUNCATE, _IOCTL = 1 << 0, 1 << 1, 1 << 2, 1 << 14, 1 << 15
_FOLDER_RIGHTS = sum(1 << bit for bit in range(4, 13))
_LATER_RIGHTS = {2: 1 << 13, 3: _TRUNCATE, 5: _IOCTL}
_FILE_RIGHTS = _EXECUTE | _WRITE | _READ | _TRUNCATE | _IOCTL
#: Rights in the folder of a recording: write, remove and create files.
_RECORDING_RIGHTS = _WRITE | 1 << 5 | 1 << 8
#: Rights to bind and connect by TCP; scope of signals.
_TCP, _RULE_CALL, _SIGNALS = 3, 2, 2

_NO_NEW_PRIVILEGES, _SECCOMP, _FILTER = 38, 22, 2
#: For each processor: its audit architecture and the number of socket().
_PROCESSORS = {"x86_64": (0xC000003E, 41), "aarch64": (0xC00000B7, 198), "armv7l": (0x40000028, 281)}
_IO_URING_SETUP = 425
#: AF_UNIX and AF_CAN.
_FAMILIES = (1, 29)
_LOAD, _EQUAL, _AT_LEAST, _RETURN = 0x20, 0x15, 0x35, 0x06
_ALLOWED, _REFUSED = 0x7FFF0000, 0x00050000
_EPERM, _EAFNOSUPPORT, _ENOSYS = 1, 97, 38

_libc = ctypes.CDLL(None, use_errno=True)
_libc.syscall.restype = ctypes.c_long
_libc.prctl.argtypes = [ctypes.c_int, *[ctypes.c_ulong] * 4]


def landlock_abi() -> int:
    """The version of this kernel's Landlock, 0 for none."""
    return int(max(0, _libc.syscall(_CREATE, None, ctypes.c_size_t(0), ctypes.c_uint(_VERSION))))


def describe_sandbox() -> tuple[str, str]:
    """Descriptions of the features that this kernel enforces, and of those that it does not ('' for none)."""
    version = landlock_abi()
    if not version:
        return "", "this kernel has no Landlock (5.13 has; see CONFIG_SECURITY_LANDLOCK and 'lsm=')"
    enforced = (
        ["files"] + ["TCP"] * (version >= 4) + ["devices"] * (version >= 5) + ["signals"] * (version >= 6)
    )
    missing = ["TCP"] * (version < 4) + ["devices"] * (version < 5) + ["signals"] * (version < 6)
    if platform.machine() in _PROCESSORS:
        enforced.append("sockets")
    else:
        missing.append("sockets")
    return ", ".join(enforced), ", ".join(missing)


def apply_sandbox(policy: SandboxPolicy) -> None:
    """Restricts this process and its children to the policy, as far as the kernel can.

    Call this function before a second thread exists, which would keep its rights. Raises OSError if the
    kernel supports the restriction but fails.
    """
    _checked(_libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0))
    if version := landlock_abi():
        _landlock(policy, version)
    if not policy.has_internet and platform.machine() in _PROCESSORS:
        _filter_sockets(*_PROCESSORS[platform.machine()])


def _landlock(policy: SandboxPolicy, version: int) -> None:
    handled = (
        _EXECUTE
        | _WRITE
        | _READ
        | _FOLDER_RIGHTS
        | sum(bit for since, bit in _LATER_RIGHTS.items() if version >= since)
    )
    network = _TCP if version >= 4 and policy.ports is not None else 0
    attributes = struct.pack("=QQQ", handled, network, _SIGNALS if version >= 6 else 0)
    size = 24 if version >= 6 else 16 if version >= 4 else 8
    rules = _checked(_libc.syscall(_CREATE, attributes, ctypes.c_size_t(size), ctypes.c_uint(0)))
    try:
        runs = _EXECUTE if policy.may_execute else 0
        _add_paths(rules, policy.readable, handled & (_READ | runs))
        _add_paths(rules, policy.writable, handled & (_FILE_RIGHTS & ~_EXECUTE))
        _add_paths(rules, policy.folders, handled & ~_EXECUTE)
        _add_paths(rules, [policy.recording] if policy.recording else [], _RECORDING_RIGHTS)
        for port in policy.ports or () if network else ():
            _add_rule(rules, _PORT, struct.pack("=QQ", _RULE_CALL, port))
        _checked(_libc.syscall(_RESTRICT, ctypes.c_int(rules), ctypes.c_uint(0)))
    finally:
        os.close(rules)


def _add_paths(rules: int, paths: Iterable[str], rights: int) -> None:
    """Grants rights for files, and for all files below folders; missing paths are skipped."""
    for path in paths:
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
            try:
                folder = stat.S_ISDIR(os.fstat(descriptor).st_mode)
                _add_rule(
                    rules, _PATH, struct.pack("=Qi", rights if folder else rights & _FILE_RIGHTS, descriptor)
                )
            finally:
                os.close(descriptor)


def _add_rule(rules: int, kind: int, rule: bytes) -> None:
    _checked(_libc.syscall(_ADD, ctypes.c_int(rules), ctypes.c_int(kind), rule, ctypes.c_uint(0)))


def _filter_sockets(processor: int, socket: int) -> None:
    """Denies sockets other than Unix and CAN, since Landlock covers only TCP; denies io_uring, which bypasses
    the filter.
    """
    allowed, refused = (_RETURN, 0, 0, _ALLOWED), (_RETURN, 0, 0, _REFUSED | _EAFNOSUPPORT)
    families = [(_EQUAL, len(_FAMILIES) - at, 0, family) for at, family in enumerate(_FAMILIES)]
    program = [
        (_LOAD, 0, 0, 4),
        (_EQUAL, 1, 0, processor),
        (_RETURN, 0, 0, _REFUSED | _ENOSYS),
        (_LOAD, 0, 0, 0),
        # The x32 ABI of the same processor has other system call numbers.
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
    filter_program = ctypes.create_string_buffer(struct.pack("@HP", len(program), ctypes.addressof(code)))
    _checked(_libc.prctl(_SECCOMP, _FILTER, ctypes.addressof(filter_program), 0, 0))


def _checked(result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result
