"""A poor radio link: a relay between station and vehicle that drops random packets in both directions."""

from __future__ import annotations

import random
import select
import socket
import threading
from collections.abc import Iterator

#: MAVLink 1 and 2: start marker -> bytes around the payload; a signature adds 13 bytes.
_OVERHEAD = {0xFE: 8, 0xFD: 12}
_SIGNED, _SIGNATURE = 0x01, 13
#: Seconds between two checks for the end.
POLL_INTERVAL = 0.2


class Frames:
    """Cuts a stream of bytes into MAVLink packets; bytes between packets are dropped."""

    def __init__(self) -> None:
        self._rest = b""

    def cut(self, data: bytes) -> Iterator[bytes]:
        """The packets that are complete by now."""
        self._rest += data
        while self._rest:
            length = self._length()
            if length is None or len(self._rest) < length:
                return
            packet, self._rest = self._rest[:length], self._rest[length:]
            if packet[0] in _OVERHEAD:
                yield packet

    def _length(self) -> int | None:
        """The length of the first packet; 1 for a byte outside packets, None while the length is unknown."""
        marker = self._rest[0]
        if marker not in _OVERHEAD:
            return 1
        if len(self._rest) < 3:
            return None
        signed = marker == 0xFD and self._rest[2] & _SIGNED
        return self._rest[1] + _OVERHEAD[marker] + (_SIGNATURE if signed else 0)


class Relay:
    """A relay between a vehicle (`tcp:`, `udp:` or `udpin:HOST:PORT`) and the station at `endpoint`.

    `loss` is the probability that a packet is dropped, in each direction; `seed` makes the losses repeatable.
    """

    def __init__(self, vehicle: str, loss: float, seed: int = 1) -> None:
        self._loss, self._rng = loss, random.Random(seed)
        self._vehicle, self._peer = _connected(vehicle)
        self._endpoint = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._endpoint.bind(("127.0.0.1", 0))
        self.endpoint = f"udp:127.0.0.1:{self._endpoint.getsockname()[1]}"
        self._station: tuple[str, int] | None = None
        self.passed = self.lost = 0
        self._ended = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Closes the relay."""
        self._ended = True
        self._thread.join()
        self._vehicle.close()
        self._endpoint.close()

    def _run(self) -> None:
        from_vehicle, to_vehicle = Frames(), Frames()
        while not self._ended:
            ready, _, _ = select.select([self._vehicle, self._endpoint], [], [], POLL_INTERVAL)
            if self._vehicle in ready:
                data, self._peer = _received(self._vehicle, self._peer)
                for packet in from_vehicle.cut(data):
                    if self._station is not None and self._is_passed():
                        self._endpoint.sendto(packet, self._station)
            if self._endpoint in ready:
                data, self._station = self._endpoint.recvfrom(65535)
                for packet in to_vehicle.cut(data):
                    if self._is_passed():
                        self._to_vehicle(packet)

    def _is_passed(self) -> bool:
        lost = self._rng.random() < self._loss
        self.lost += lost
        self.passed += not lost
        return not lost

    def _to_vehicle(self, packet: bytes) -> None:
        if self._peer is None:
            self._vehicle.send(packet)
        elif self._peer != ("", 0):
            self._vehicle.sendto(packet, self._peer)


def _connected(endpoint: str) -> tuple[socket.socket, tuple[str, int] | None]:
    """A socket to a vehicle, and its peer address; with `udpin`, `("", 0)` until the first packet arrives."""
    kind, host, port = endpoint.split(":")
    address = (host, int(port))
    if kind == "tcp":
        return socket.create_connection(address, 10.0), None
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    if kind == "udp":
        opened.connect(address)
        return opened, None
    opened.bind(address)
    return opened, ("", 0)


def _received(vehicle: socket.socket, peer: tuple[str, int] | None) -> tuple[bytes, tuple[str, int] | None]:
    """Received bytes and the address of the vehicle; no bytes if the vehicle does not listen yet."""
    try:
        if peer is None:
            return vehicle.recv(65535), None
        return vehicle.recvfrom(65535)
    except ConnectionRefusedError:
        return b"", peer
