"""Plays the inputs of a recording to the fake, in virtual time, and records the fake in the same form.

The recorder waited for events: ready, standing, up or down, item reached. The inputs are sent at their
recorded times; where the fake has not yet reached the same event, the recording pauses (at most `TIMEOUT`
seconds, once until they agree again) and all later times are shifted. The pause is reported as a difference.
Times in the result are those of the recording.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import all as dialect
from replay_inputs import BEAT, inputs
from replay_trace import PRE_ARM, Line, Trace

from lfield_sim.autopilot.autopilot import FLAVOURS, Autopilot
from lfield_sim.autopilot.equipment.payload import Payload
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.link.radio_link import make_faults
from lfield_sim.mavlink.mavlink_fake import MavlinkFake

#: Seconds: a time step, and the maximum wait of the recording for the fake.
TICK, TIMEOUT = 0.02, 10.0
#: Seconds for which the real vehicle must have stood still.
STOOD = 1.5
#: Minimum seconds between two compared messages of a type.
THIN = dict.fromkeys(
    (
        "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE", "SYS_STATUS", "GPS_RAW_INT", "VFR_HUD",
        "EKF_STATUS_REPORT", "ESTIMATOR_STATUS", "BATTERY_STATUS", "POSITION_TARGET_LOCAL_NED", "ALTITUDE",
        "ATTITUDE_QUATERNION", "HIGHRES_IMU",
    ),
    0.2,
)  # fmt: skip
FTP_OPS = {
    "none": 0, "terminate": 1, "reset": 2, "list": 3, "open_ro": 4, "read": 5, "create": 6, "write": 7,
    "remove": 8, "mkdir": 9, "rmdir": 10, "open_wo": 11, "truncate": 12, "rename": 13, "crc": 14, "burst": 15,
    "list_time": 16,
}  # fmt: skip
NAK = 129
#: Seconds of a start of ArduPilot and of PX4, for a recording that ends before.
WARM_UP = (42.6, 6.0)
#: The same for an ArduPilot whose pre-arm bit does not show the end of the start.
EARLY = 41.9
#: Commands after which a vehicle moves, stops or is permitted to move.
MOTIONS = {20, 21, 22, 34, 115, 176, 178, 185, 192, 193, 209, 213, 300, 310, 400}
TYPES = {cls.msgname: (number, cls) for number, cls in dialect.mavlink_map.items()}
IDS = {number: cls.msgname for number, cls in dialect.mavlink_map.items()}


@dataclass
class Played:
    """The messages of the fake, their times by type, and the waits for it (time, seconds, event)."""

    trace: Trace
    counts: dict[str, list[float]]
    holds: list[tuple[float, float, str]]


def play(trace: Trace) -> Played:
    """Plays the whole recording."""
    player = _Player(trace)
    for line in inputs(trace):
        player.feed(line)
    player.run_until(trace.end)
    return Played(Trace(trace.name, trace.header, player.sent_lines), player.counts, player.holds)


def make_fake(trace: Trace) -> MavlinkFake:
    """The fake of this vehicle, at its recorded position, with its warm-up."""
    kinds = FLAVOURS["px4" if trace.px4 else "ardupilot"]
    name = str(trace.header["vehicle"])
    name = "rover_skid" if "skid" in trace.name else name
    origin = (trace.out("GPS_GLOBAL_ORIGIN") or trace.out("HOME_POSITION") or [None])[0]
    place = GeoOrigin()
    if origin is not None:
        latitude, longitude, altitude = (origin.get(n) for n in ("latitude", "longitude", "altitude"))
        place = GeoOrigin(latitude / 1e7, longitude / 1e7, altitude / 1000)
    system = next(
        (int(line.get("target_system")) for line in trace.inputs if "target_system" in line.fields), 1
    )
    ready = trace.first("SYS_STATUS", lambda s: bool(int(s.get("onboard_control_sensors_health")) & PRE_ARM))
    # In a mode that needs no position an ArduCopter can be armed long before the end of its start.
    early = not trace.px4 and (ready is None or ready < 0.9 * WARM_UP[0])
    warm_up = EARLY if early else WARM_UP[trace.px4] if ready is None else max(0.1, ready - 0.3)
    faults = make_faults(f"warm_up={min(warm_up, 600.0)}", systems=(system,))
    bare = Autopilot(kinds[name], payload=Payload(frozenset()))
    return MavlinkFake(bare, system=system, place=place, faults=faults)


@dataclass
class _Player:
    trace: Trace
    sent_lines: list[Line] = field(default_factory=list)
    counts: dict[str, list[float]] = field(default_factory=dict)
    holds: list[tuple[float, float, str]] = field(default_factory=list)
    now: float = 0.0
    held: float = 0.0
    patient: bool = True

    def __post_init__(self) -> None:
        self.fake = make_fake(self.trace)
        self.writers: dict[int, Any] = {}
        self.decoder: Any = dialect.MAVLink(None)
        self.decoder.robust_parsing = True
        self.recorded_at: dict[str, float] = {}
        self.newest: dict[str, Line] = {}
        self.closed = False
        self.started_mission = 0.0
        self.moved_at = 0.0
        self.station: Line | None = None
        self.reached: set[float] = set()

    def feed(self, line: Line) -> None:
        """Sends one input at its time, or when the fake has reached the same event."""
        self.run_until(line.t)
        if line.heartbeat is False:
            self.station = None
        if line.type == "HEARTBEAT":
            self.station = line
        if line.dir == "note":
            if line.heartbeat is None:
                self.closed = line.text.startswith("link closed")
            return
        if line.type != "HEARTBEAT" and line.dir == "in":
            self._hold(line)
        if line.fields.get("command") == 300:
            self.started_mission = line.t
        if is_motion(line):
            self.moved_at = line.t
        self._on_packet(self.fake.receive("recorder", self._pack(line)))

    def run_until(self, t: float) -> None:
        """Advances the time of the recording."""
        while self.now < t - 1e-9:
            step = min(TICK, t - self.now)
            self.now += step
            self._on_packet(self.fake.advance(step))
        self.now = max(self.now, t)

    # -- waiting for the fake -------------------------------------------------------------------------

    def _hold(self, line: Line) -> None:
        missing = wanted = self._missing(line)
        if not missing:
            self.patient = True
            return
        waited = 0.0
        while self.patient and missing and waited < TIMEOUT:
            self.held += TICK
            self._on_packet(self.fake.advance(TICK))
            waited += TICK
            # The recorder's heartbeats would have continued during the wait.
            if self.station is not None and waited % BEAT < TICK:
                self._on_packet(self.fake.receive("recorder", self._pack(self.station)))
            missing = self._missing(line)
        if missing:
            self.patient = False
        if waited > 1.0:
            self.holds.append((line.t, waited, wanted))

    def _missing(self, line: Line) -> str:
        """The event that the real vehicle had reached by now and the fake has not, "" if none."""
        if line.fields.get("command") in (511, 512):
            return ""
        for name, is_missing in (
            ("disarmed", self._is_to_be_disarmed), ("ready", self._is_to_be_ready),
            ("standing", self._is_to_stand), ("item reached", self._is_to_reach),
        ):  # fmt: skip
            if is_missing(line.t):
                return name
        return ""

    def _is_to_be_disarmed(self, t: float) -> bool:
        real, own = self.trace.last("HEARTBEAT", t), self.newest.get("HEARTBEAT")
        if real is None or own is None or _armed(real) or not _armed(own):
            return False
        times = [
            line.t for line in self.trace.inputs if line.fields.get("command") in (400, 300) and line.t < t
        ]
        since = max(times, default=0.0)
        return any(_armed(heartbeat) for heartbeat in self.trace.between(since, t, "HEARTBEAT"))

    def _is_to_be_ready(self, t: float) -> bool:
        heartbeat = self.trace.last("HEARTBEAT", t)
        if heartbeat is not None and _armed(heartbeat):
            # No wait for a flying vehicle: its bit changes often.
            return False
        real, own = self.trace.last("SYS_STATUS", t), self.newest.get("SYS_STATUS")
        return real is not None and own is not None and _fit(real) and not _fit(own)

    def _is_to_stand(self, t: float) -> bool:
        if t - self.moved_at < 1.6:
            return False
        real, own = self.trace.last("LOCAL_POSITION_NED", t), self.newest.get("LOCAL_POSITION_NED")
        if real is None or own is None:
            return False
        # A vehicle that turns back also stands for a moment: no wait for that.
        stood = all(map(_stands, self.trace.between(t - STOOD, t, "LOCAL_POSITION_NED")))
        return _stands(real) and stood and (_speed(own) > 0.5 or abs(own.get("vz")) > 0.4)

    def _is_to_reach(self, t: float) -> bool:
        real = {
            line.get("seq") for line in self.trace.between(self.started_mission, t, "MISSION_ITEM_REACHED")
        }
        return bool(real) and self.started_mission > 0.0 and max(real) not in self.reached

    # -- packets --------------------------------------------------------------------------------------

    def _pack(self, line: Line) -> bytes:
        writer = self.writers.get(line.system)
        if writer is None:
            writer = self.writers[line.system] = dialect.MAVLink(
                None, srcSystem=line.system, srcComponent=190
            )
        packet = bytes(_message(line, self.fake.system).pack(writer))
        writer.seq = (writer.seq + 1) % 256
        return packet

    def _on_packet(self, packets: list[bytes]) -> None:
        if self.closed:
            return
        for packet in packets:
            name = IDS.get(int.from_bytes(packet[7:10], "little"), "")
            self.counts.setdefault(name, []).append(self.now)
            if self.now + self.held - self.recorded_at.get(name, -9.0) < THIN.get(name, 0.0):
                continue
            self.recorded_at[name] = self.now + self.held
            message = self.decoder.decode(bytearray(packet))
            line = Line(self.now, "out", name, _fields(message))
            self.sent_lines.append(line)
            self.newest[name] = line
            if name == "MISSION_ITEM_REACHED":
                self.reached.add(line.get("seq"))


def is_motion(line: Line) -> bool:
    """Whether an input may set the vehicle in motion, or stop it."""
    if line.type.startswith("COMMAND"):
        return line.fields["command"] in MOTIONS
    return line.type.startswith("SET_")


def _message(line: Line, system: int) -> Any:
    if line.type == "HEARTBEAT":
        return dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    if line.type == "FTP":
        return dialect.MAVLink_file_transfer_protocol_message(0, system, 1, _ftp_request(line.fields))
    _, cls = TYPES[line.type]
    values = {}
    for name, value in line.fields.items():
        value = math.nan if value is None else value
        value = value.encode() if isinstance(value, str) else value
        values[name] = system if name == "target_system" and value else value
    return cls(**values)


def _ftp_request(fields: dict[str, Any]) -> bytes:
    data = str(fields["data"]).encode("latin1")
    head = struct.pack(
        "<HBBBBBxI",
        fields["seq"],
        fields["session"],
        FTP_OPS[fields["op"]],
        fields["size"],
        0,
        0,
        fields["offset"],
    )
    return (head + data).ljust(251, b"\0")


def _fields(message: Any) -> dict[str, Any]:
    if message.get_type() == "FILE_TRANSFER_PROTOCOL":
        return ftp_reply(bytes(message.payload))
    return {name: _plain(getattr(message, name)) for name in message.get_fieldnames()}


def ftp_reply(payload: bytes) -> dict[str, Any]:
    """A reply of FTP as fields."""
    seq, session, opcode, size, _, _, offset = struct.unpack_from("<HBBBBBxI", payload)
    data = payload[12 : 12 + size]
    return {"seq": seq, "session": session, "nak": opcode == NAK, "offset": offset, "data": data}


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, (bytes, bytearray)):
        return bytes(value).rstrip(b"\0").decode("latin1")
    return value


def _armed(beat: Line) -> bool:
    return bool(int(beat.get("base_mode")) & 128)


def _fit(status: Line) -> bool:
    return bool(int(status.get("onboard_control_sensors_health")) & PRE_ARM)


def _stands(position: Line) -> bool:
    return _speed(position) < 0.3 and abs(position.get("vz")) < 0.3


def _speed(position: Line) -> float:
    return math.hypot(position.get("vx"), position.get("vy"))
