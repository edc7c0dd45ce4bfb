"""The inputs of an autopilot; inputs that the recorder omitted are reconstructed.

The recorder omitted heartbeats (it notes when they are switched on and off), all but each 20th streamed
setpoint, and everything sent with `record=False`. The times of streams are taken from the recorder's notes,
their ends from its own rule (`2.5 s after the mode was seen`).
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace

from replay_trace import Line, Trace

LOCAL, ATTITUDE = "SET_POSITION_TARGET_LOCAL_NED", "SET_ATTITUDE_TARGET"
#: Seconds between two heartbeats.
BEAT = 1.0
#: Seconds for which a due heartbeat waits for the next note, since the recorder notes a switch afterwards.
SWITCH = 0.015


@dataclass(frozen=True, slots=True)
class Stream:
    """Equal setpoints in a time span, at a fixed rate."""

    start: float
    end: float
    rate: float
    type: str = LOCAL
    vx: float = 0.0
    vz: float = 0.0
    afx: float = 0.0
    yaw_rate: float = 0.0
    type_mask: int = 0x0DC7

    def lines(self) -> Iterator[Line]:
        count = int((self.end - self.start) * self.rate)
        for number in range(count + 1):
            yield Line(self.start + number / self.rate, "in", self.type, self._fields())

    def _fields(self) -> dict[str, object]:
        if self.type == ATTITUDE:
            return {
                "time_boot_ms": 0, "target_system": 1, "target_component": 1, "type_mask": self.type_mask,
                "q": [1.0, 0.0, 0.0, 0.0], "body_roll_rate": 0.0, "body_pitch_rate": 0.0,
                "body_yaw_rate": self.yaw_rate, "thrust": 0.0,
            }  # fmt: skip
        zero = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"), 0.0)
        fields = {"vx": self.vx, "vz": self.vz, "afx": self.afx, "yaw_rate": self.yaw_rate}
        head = {"time_boot_ms": 0, "target_system": 1, "target_component": 1, "coordinate_frame": 1}
        return {**head, "type_mask": self.type_mask, **zero, **fields}


def _offboard(*spans: tuple[float, float]) -> list[Stream]:
    return [Stream(start, end, 20.0, vx=1.0) for start, end in spans]


STREAMS: dict[str, list[Stream]] = {
    "px4-copter.d-velocity": [
        *_offboard(
            (172.243, 173.69), (179.692, 180.74), (183.731, 184.80), (187.776, 188.84),
            (191.806, 192.88), (196.902, 199.01), (201.994, 204.20),
        ),
        Stream(207.25, 210.43, 20.0, vx=2.0),
        Stream(215.02, 221.11, 4.0, vx=1.0),
        Stream(223.64, 229.25, 2.5, vx=1.0),
        Stream(231.91, 237.26, 2.0, vx=1.0),
        Stream(239.91, 245.37, 1.0, vx=1.0),
        Stream(247.88, 251.47, 20.0, afx=0.5, type_mask=0x0C3F),
        Stream(253.98, 255.95, 20.0),
        Stream(256.00, 258.00, 20.0, yaw_rate=0.5, type_mask=0x05C7),
        Stream(293.84, 298.89, 20.0, vz=-1.0),
    ],
    "px4-copter.f-fence-landing": [Stream(23.27, 36.04, 15.0, vx=4.0), Stream(72.18, 85.57, 12.0, vx=4.0)],
    "px4-rover.l-px4-rover": [Stream(45.80, 50.82, 20.0, vx=1.0)],
    "ap-copter.f-fence-breach": [
        Stream(52.077, 60.73, 4.0, vx=4.0), Stream(72.923, 82.01, 4.0, vx=4.0),
        Stream(94.25, 103.39, 4.0, vx=4.0),
    ],
    "ap-rover.f-fence-breach": [Stream(42.749, 52.33, 4.0, vx=4.0), Stream(66.672, 76.73, 4.0, vx=4.0)],
}  # fmt: skip


def inputs(trace: Trace) -> list[Line]:
    """All inputs of the autopilot in the order of time, with the notes about the link."""
    extra = [line for stream in STREAMS.get(trace.name, []) for line in stream.lines()]
    return list(
        heapq.merge(
            _heartbeats(trace),
            (
                _whole(trace, line)
                for line in trace.lines
                if line.dir == "in" and not _is_filled_in(trace, line)
            ),
            (line for line in trace.notes if line.heartbeat is not None or line.text.startswith("link ")),
            sorted([*extra, *_unrecorded(trace)], key=lambda line: line.t),
            key=lambda line: line.t,
        )
    )


def _whole(trace: Trace, line: Line) -> Line:
    """Restores the coordinates of the one float item, which was home and was recorded with six digits."""
    if line.type != "MISSION_ITEM":
        return line
    home = trace.last("HOME_POSITION", line.t)
    assert home is not None
    degrees = {"x": home.get("latitude") / 1e7, "y": home.get("longitude") / 1e7}
    return replace(line, fields={**line.fields, **degrees})


def _is_filled_in(trace: Trace, line: Line) -> bool:
    """Whether a recorded setpoint belongs to a stream."""
    return line.type == LOCAL and any(
        stream.start - 0.1 <= line.t <= stream.end + 0.1 and line.get("type_mask") == stream.type_mask
        for stream in STREAMS.get(trace.name, [])
    )


def _heartbeats(trace: Trace) -> Iterator[Line]:
    """One when they are switched on, if the last is a second old, then one each second."""
    switched = [line for line in trace.notes if line.heartbeat is not None]
    due = 0.0
    for line, after in zip(switched, [*switched[1:], None], strict=True):
        end = after.t if after else trace.end
        if not line.heartbeat:
            continue
        system = int(line.text.partition("system ")[2].partition(",")[0])
        due = max(due, line.t)
        while due < end - SWITCH:
            yield Line(due, "in", "HEARTBEAT", {}, system=system)
            due += BEAT


def _unrecorded(trace: Trace) -> Iterator[Line]:
    """Inputs without a line: the setpoints between commands of scenario e, the attitudes of h."""
    for line in trace.inputs:
        if trace.name.startswith("ap-") and trace.scenario == "e-gcs-loss" and _is_filler(line):
            yield next(Stream(line.t - 0.01, line.t - 0.01, 1.0, vx=0.5).lines())
    for note in trace.notes:
        if note.text.startswith("FACT SET_ATTITUDE_TARGET"):
            start = note.t - 2.0
            yield from Stream(start, start + 1.76, 4.0, ATTITUDE, yaw_rate=0.5, type_mask=0x83).lines()


def _is_filler(line: Line) -> bool:
    return line.fields.get("command") == 512 and line.get("param1") == 242
