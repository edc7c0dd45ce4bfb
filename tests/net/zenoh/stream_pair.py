"""Two ends of a numbered stream over a simulated fabric that loses, repeats and reorders packets."""

import heapq
import random

from lfield.net.zenoh.stream import Closed, Deliver, NumberedStream, Opened, SendPacket

DELAY = 0.01


class End:
    """One end with its owner: the received bytes, and why the stream ended."""

    def __init__(self, stream: NumberedStream) -> None:
        self.stream = stream
        self.received = bytearray()
        self.opened = 0
        self.ends: list[str] = []


class StreamPair:
    """A caller and a called end. `lose`, `repeat` and `reorder` are probabilities of each packet."""

    def __init__(self, seed: int = 0, lose: float = 0.0, repeat: float = 0.0, reorder: float = 0.0) -> None:
        self.now, self.rng = 100.0, random.Random(seed)
        self.lose, self.repeat, self.reorder = lose, repeat, reorder
        #: Seconds that one byte takes; packets of one direction share the path.
        self.per_byte = 0.0
        self._free = {True: 0.0, False: 0.0}
        self.near = End(NumberedStream(self.now, calls=True))
        self.far = End(NumberedStream(self.now, calls=False))
        self._queue: list[tuple[float, int, End, bytes]] = []
        self.sent: list[tuple[bool, bytes]] = []
        self._count = 0
        #: Decides whether a packet is lost: (from the caller, packet) -> bool.
        self.is_lost = lambda calls, data: False
        #: Ends whose process is stopped: they do nothing.
        self.stopped: set[int] = set()

    def do(self, end: End, effects) -> None:
        """Execute the effects of an end."""
        for effect in effects:
            assert not end.ends, "Closed is the last effect"
            match effect:
                case SendPacket(data):
                    self._send(end, data)
                case Deliver(data):
                    end.received += data
                case Opened():
                    end.opened += 1
                case Closed(reason):
                    end.ends.append(reason)

    def _send(self, end: End, data: bytes) -> None:
        calls = end is self.near
        self.sent.append((calls, data))
        if self.is_lost(calls, data) or self.rng.random() < self.lose:
            return
        other = self.far if calls else self.near
        start = max(self.now, self._free[calls])
        self._free[calls] = start + len(data) * self.per_byte
        for _ in range(1 + (self.rng.random() < self.repeat)):
            late = self.rng.random() * 0.5 if self.rng.random() < self.reorder else 0.0
            at = self._free[calls] + DELAY + late
            self._count += 1
            heapq.heappush(self._queue, (at, self._count, other, data))

    def run(self, seconds: float) -> None:
        """Advance the time."""
        end = self.now + seconds
        while True:
            ends = [each for each in (self.near, self.far) if id(each) not in self.stopped]
            due = [(each.stream.deadline, each) for each in ends if each.stream.deadline is not None]
            first = min((at for at, _ in due), default=float("inf"))
            if self._queue and self._queue[0][0] <= min(first, end):
                self.now, _, other, data = heapq.heappop(self._queue)
                if id(other) not in self.stopped and not other.ends:
                    self.do(other, other.stream.on_packet(data, self.now))
                continue
            if first > end:
                break
            self.now = max(self.now, first)
            for at, each in due:
                if at <= self.now:
                    self.do(each, each.stream.on_time(self.now))
        self.now = end

    def write(self, end: End, data: bytes) -> None:
        self.do(end, end.stream.write(data, self.now))

    def close(self, end: End) -> None:
        self.do(end, end.stream.close(self.now))
