"""TUN devices in network namespaces, and their requirements (tuntap.rst, setns(2))."""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import struct
import subprocess
from pathlib import Path

DEVICE = "air0"
CLONE = Path("/dev/net/tun")
_TOOLS = ("unshare", "nsenter", "ip")
_CLONE_NEWNET = 0x40000000
_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_libc = ctypes.CDLL(None, use_errno=True)


def missing() -> str:
    """The missing requirement for an emulated radio on this computer, as a sentence; "" if there is none."""
    if os.geteuid():
        return "the emulated radio needs root: start it with sudo"
    if not CLONE.exists():
        return f"the emulated radio needs {CLONE}: load the kernel module tun"
    if absent := [tool for tool in _TOOLS if shutil.which(tool) is None]:
        return f"the emulated radio needs {', '.join(absent)}: install util-linux and iproute2"
    result = subprocess.run(["unshare", "--net", "true"], capture_output=True, text=True)
    if result.returncode:
        return f"the emulated radio needs network namespaces: {result.stderr.strip()}"
    try:
        os.close(os.open(CLONE, os.O_RDWR))
    except OSError as error:
        return f"the emulated radio needs {CLONE}: {error.strerror}"
    return ""


def open_tun(pid: int) -> int:
    """A non-blocking descriptor of a new TUN device in the network namespace of a process.

    This thread stays in that namespace. Raises OSError.
    """
    namespace = os.open(f"/proc/{pid}/ns/net", os.O_RDONLY)
    try:
        if _libc.setns(namespace, _CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), "setns")
    finally:
        os.close(namespace)
    device = os.open(CLONE, os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", DEVICE.encode(), _IFF_TUN | _IFF_NO_PI))
    return device
