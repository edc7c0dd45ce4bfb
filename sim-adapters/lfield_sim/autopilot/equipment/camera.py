"""A camera with a card: single pictures, series, video. No clock: the time is given, in seconds.

The states and refusals are those of the camera protocol, https://mavlink.io/en/services/camera.html.
"""

from __future__ import annotations

from collections import deque

from msgspec import Struct, field

from lfield_sim.autopilot.flavours import MavResult

#: CAMERA_MODE.
IMAGE, VIDEO = 0, 1
#: Seconds from the command to the picture; MiB of a picture, and MiB/s of video.
EXPOSURE, IMAGE_SIZE, VIDEO_RATE = 0.3, 8.0, 6.0
#: The card in MiB, and the shortest interval of a series in seconds.
CARD, SHORTEST = 32_000.0, 0.5


class CameraModel(Struct):
    """A camera. `shot` has the outcome of each picture that the caller has not collected yet."""

    card: float = CARD
    used: float = 0.0
    mode: int = IMAGE
    pictures: int = 0
    broken: bool = False
    interval: float = 0.0
    recording_since: float | None = None
    shot: deque[bool] = field(default_factory=lambda: deque(maxlen=100))
    _remaining: float = 0
    _due: float = 0.0
    _sequence: int = 0
    _now: float = 0.0

    @property
    def free(self) -> float:
        """MiB left on the card."""
        return max(self.card - self.used, 0.0)

    @property
    def is_full(self) -> bool:
        """Whether no picture fits on the card."""
        return self.free < IMAGE_SIZE

    @property
    def is_shooting(self) -> bool:
        """Whether a picture or a series is being taken."""
        return self._remaining > 0

    def shoot(self, now: float, interval: float = 0.0, count: int = 1, sequence: int = 0) -> MavResult:
        """Starts a picture, or a series of `count` pictures (0: until stopped).

        A single picture with the `sequence` of the previous one is the same command, sent again.
        """
        if count == 1 and sequence and sequence == self._sequence:
            return MavResult.ACCEPTED
        if self.mode != IMAGE or count < 0 or (count != 1 and interval < SHORTEST):
            return MavResult.DENIED
        if self.is_shooting:
            return MavResult.TEMPORARILY_REJECTED
        if self.is_full:
            return MavResult.FAILED
        self._remaining, self._due = count or float("inf"), now + EXPOSURE
        self.interval, self._sequence = (interval if count != 1 else 0.0), sequence
        return MavResult.ACCEPTED

    def stop_shooting(self) -> MavResult:
        """Ends a series."""
        self._remaining, self.interval = 0, 0.0
        return MavResult.ACCEPTED

    def record(self, now: float) -> MavResult:
        """Starts a video."""
        if self.mode != VIDEO:
            return MavResult.DENIED
        if self.recording_since is not None:
            return MavResult.TEMPORARILY_REJECTED
        if self.is_full:
            return MavResult.FAILED
        self.recording_since = now
        return MavResult.ACCEPTED

    def stop_recording(self) -> MavResult:
        """Ends a video."""
        self.recording_since = None
        return MavResult.ACCEPTED

    def set_mode(self, mode: int) -> MavResult:
        """Changes between pictures and video; refused while the camera takes either."""
        if mode not in (IMAGE, VIDEO):
            return MavResult.DENIED
        if mode != self.mode and (self.is_shooting or self.recording_since is not None):
            return MavResult.TEMPORARILY_REJECTED
        self.mode = mode
        return MavResult.ACCEPTED

    def step(self, now: float) -> None:
        """Advances to a time: takes the picture that is due, and writes the video. A full card ends both."""
        if self.recording_since is not None:
            self.used += VIDEO_RATE * (now - self._now)
        self._now = now
        if self.is_shooting and now >= self._due:
            self._expose()
        if self.free <= 0.0:
            self.used, self.recording_since = self.card, None

    def _expose(self) -> None:
        is_stored = not (self.broken or self.is_full)
        self.used += IMAGE_SIZE * is_stored
        self.pictures += 1
        self.shot.append(is_stored)
        self._remaining = self._remaining - 1 if not self.is_full else 0
        self._due += self.interval
        if not self._remaining:
            self.interval = 0.0
