"""pymavlink's own connection, used as in its examples: the reference of the figure `mavlink`.

python mavlink_raw.py PORT COUNT   prints rounds of the seconds of each command until it is killed
"""

from __future__ import annotations

import os
import sys
import time
from typing import Any

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # selects its dialect from the environment at import


def connect(port: str) -> Any:
    """Connect as a ground station."""
    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", dialect="ardupilotmega", source_system=255)
    link.mav.heartbeat_send(6, 8, 0, 0, 4)
    link.recv_match(type="HEARTBEAT", blocking=True, timeout=10)
    return link


def command(port: str, count: str) -> None:
    """Send rounds of commands that move nothing. The samples are printed after each round."""
    link = connect(port)
    while True:
        # Messages that arrived while this process was stopped.
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
