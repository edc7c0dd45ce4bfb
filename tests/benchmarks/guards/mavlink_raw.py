"""pymavlink's own connection, as its examples use it: the other side of the figure `mavlink`.

python mavlink_raw.py PORT COUNT   rounds of the seconds of each command, for ever
"""

from __future__ import annotations

import os
import sys
import time
from typing import Any

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # it chooses its dialect by the environment when it is imported


def connect(port: str) -> Any:
    """A ground station that the fake answers."""
    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", dialect="ardupilotmega", source_system=255)
    link.mav.heartbeat_send(6, 8, 0, 0, 4)
    link.recv_match(type="HEARTBEAT", blocking=True, timeout=10)
    return link


def command(port: str, count: str) -> None:
    """A command that moves nothing, again and again; nobody is woken by what is printed until the end."""
    link = connect(port)
    while True:
        # What has come while this process stood still.
        while link.recv_match() is not None:
            pass
        samples = []
        for _ in range(int(count)):
            start = time.perf_counter()
            link.mav.command_long_send(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0)
            while link.recv_match(type="COMMAND_ACK", blocking=True, timeout=2).command != 512:
                pass
            samples.append(time.perf_counter() - start)
        print("command to acknowledgement =", *(f"{sample:.7f}" for sample in samples), flush=True)
        print("end", flush=True)
        time.sleep(0.25)


if __name__ == "__main__":
    command(*sys.argv[1:])
