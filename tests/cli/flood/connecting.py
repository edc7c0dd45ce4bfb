"""A client without keys that connects continuously and sends nothing: `python connecting.py PORT KEEP`.
Prints the number of its connections once a second. `KEEP` connections stay open, the oldest is closed first.
"""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections import deque

#: A connection is closed by a reset, so that this computer does not run out of ports.
RESET = struct.pack("ii", 1, 0)


def main() -> None:
    """Connect until stopped."""
    port, keep = int(sys.argv[1]), int(sys.argv[2])
    links: deque[socket.socket] = deque()
    count, last_report = 0, time.monotonic()
    while True:
        link = socket.socket()
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        link.settimeout(5.0)
        try:
            link.connect(("127.0.0.1", port))
            links.append(link)
            count += 1
        except OSError:
            link.close()
        if len(links) > keep:
            links.popleft().close()
        if time.monotonic() - last_report >= 1.0:
            last_report = time.monotonic()
            print(count, flush=True)


if __name__ == "__main__":
    main()
