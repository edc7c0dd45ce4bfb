"""The AX series: protocol 1.0, 300 degrees in 1023 counts, joint and wheel mode.

https://emanual.robotis.com/docs/en/dxl/ax/ax-12a/
"""

from __future__ import annotations

import math

from lfield.errors import UsageError
from lfield_sim.dynamixel.model import Item, Model
from lfield_sim.dynamixel.motion import Motion, catch_up
from lfield_sim.dynamixel.profile import Profile
from lfield_sim.dynamixel.servo import ERRORS_1, Servo
from lfield_sim.dynamixel.table import ControlTable, Refusal, Refused

#: Counts in a radian, and where the middle is.
COUNTS, MIDDLE = 1023.0 / math.radians(300.0), 512
#: rad/s in a count of speed (0.111 rev/min).
SPEED_UNIT = 0.111 * math.tau / 60.0
#: The greatest share of torque, and of speed in wheel mode; the bit above it means clockwise.
FULL, CLOCKWISE = 1023, 0x400
#: Bits per second, times the register Baud Rate plus one.
BAUD_BASE = 2_000_000


class AxMotion(Motion):
    """How an AX moves: at a constant speed to its goal, or as a wheel when both angle limits are 0."""

    def __init__(self, model: Model, table: ControlTable) -> None:
        super().__init__(model, table)
        self.motor.angle = MIDDLE / COUNTS

    @property
    def wheel(self) -> bool:
        """Whether it turns without end."""
        return self.table["cw_angle_limit"] == self.table["ccw_angle_limit"] == 0

    @property
    def place(self) -> float:
        """Where the shaft is, in counts."""
        return self.motor.angle * COUNTS

    @property
    def moving(self) -> bool:
        """On the way to a goal."""
        return self.under_way or abs(self.motor.speed) > SPEED_UNIT

    @property
    def under_way(self) -> bool:
        """On the way to a goal."""
        return bool(self.table["torque_enable"]) and not self.wheel and self.clock < self.profile.duration

    def reset_goals(self) -> None:
        """The goals of a servo that has just started."""
        self.table.put("moving_speed", 0)
        self.table.put("torque_limit", self.table["max_torque"])
        self.hold()

    def approach(self) -> None:
        """Plan the way to the goal position, from where it is now."""
        speed = self.table["moving_speed"] % CLOCKWISE * SPEED_UNIT * COUNTS
        goal = float(self.table["goal_position"])
        self.profile = Profile(self.place, 0.0, goal, speed or math.inf, math.inf)
        self.clock, self.resting = 0.0, False

    def step(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        motor, share = self.motor, self.table["torque_limit"] / FULL
        if self.resting or not self.table["torque_enable"]:
            motor.rest(dt)
            self.resting = motor.speed == 0.0
            return
        self.clock += dt
        if self.wheel:
            motor.drive(motor.torque_at(self._wheel_share()), share, math.inf, dt)
        else:
            self.trajectory, self.pace = self.profile.at(self.clock)
            speed = self.pace / COUNTS + catch_up((self.trajectory - self.place) / COUNTS, motor)
            motor.drive(motor.torque_for(speed, dt), share, math.inf, dt)
        self.resting = self.is_settled()

    def _wheel_share(self) -> float:
        speed = self.table["moving_speed"]
        return (speed % CLOCKWISE) / FULL * (-1.0 if speed & CLOCKWISE else 1.0)

    def is_settled(self) -> bool:
        """Whether nothing moves, and nothing will by itself."""
        return super().is_settled() and not (self.wheel and self.table["moving_speed"] % CLOCKWISE)

    def publish(self, time: float) -> None:
        """Write what is to the registers of what is present."""
        motor, put = self.motor, self.table.put
        put("present_position", round(min(1023.0, max(0.0, self.place % (math.tau * COUNTS)))))
        put("present_speed", _directed(motor.speed / SPEED_UNIT))
        put("present_load", _directed(motor.current / motor.strength.stall_current * FULL))
        put("present_voltage", round(motor.voltage * 10.0))
        put("present_temperature", round(min(255.0, motor.temperature)))
        put("moving", int(self.moving))


def _directed(value: float) -> int:
    """Size, and a bit for its direction."""
    return min(FULL, abs(round(value))) | (CLOCKWISE if value <= -0.5 else 0)


class AxServo(Servo):
    """An AX: it says in every answer what is wrong now, and after a shutdown it gives no torque."""

    def __init__(self, model: Model, now: float = 0.0) -> None:
        # What is wrong now, and what ended the torque: that is told until Torque Limit is written again.
        self._wrong = self._fatal = 0
        super().__init__(model, now)

    def make_motion(self) -> Motion:
        """An AX moves as an `AxMotion`."""
        return AxMotion(self.model, self.table)

    @property
    def baud(self) -> int:
        """Bits per second."""
        return round(BAUD_BASE / (self.table["baud_rate"] + 1))

    @property
    def protocol(self) -> int:
        """1."""
        return 1

    @property
    def secondary(self) -> int | None:
        """It has none."""
        return None

    @property
    def alert(self) -> int:
        """What is wrong now."""
        return self._wrong & ERRORS_1

    def start_with(self, id: int, baud: int, protocol: int, return_delay: float) -> None:
        """Set how it is spoken to. Raises UsageError if the model cannot."""
        if protocol != 1 or not BAUD_BASE / 255 <= baud <= BAUD_BASE / 2:
            raise UsageError(f"{self.model.name} does not speak protocol {protocol}.0 at {baud} baud")
        self.table.put("baud_rate", round(BAUD_BASE / baud) - 1)
        self.answer_as(id, return_delay)

    def watch_bus(self) -> None:
        """It has no bus watchdog."""

    def protect(self, dt: float) -> None:
        """Note what is wrong, and end the torque if Shutdown says so."""
        now = self.errors(dt)
        self._fatal |= now & self.table["shutdown"]
        self._wrong = now | self._fatal
        if now & self.table["shutdown"]:
            self.table.put("torque_enable", 0)
            self.table.put("torque_limit", 0)

    def reboot(self) -> None:
        """As after its power came back; no instruction does that, but the factory reset."""
        self.table.reset(eeprom=False)
        self._wrong = self._fatal = 0
        self.restart()

    def check(self, item: Item, value: int, secondary: bool) -> None:
        """Raises Refused: a register that cannot be written, or not with this value."""
        if not item.writable or (item.eeprom and self.table["lock"]):
            raise Refused(Refusal.ACCESS)
        if not item.low <= value <= item.high or (item.name == "lock" and value < self.table["lock"]):
            raise Refused(Refusal.RANGE)
        if item.name == "goal_position" and not self.allows_goal(value):
            raise Refused(Refusal.LIMIT)

    def allows_goal(self, place: int) -> bool:
        """Whether a goal is between the angle limits; a wheel has none."""
        table = self.table
        wheel = table["cw_angle_limit"] == table["ccw_angle_limit"] == 0
        return wheel or table["cw_angle_limit"] <= place <= table["ccw_angle_limit"]

    def follow_up(self, name: str, before: int, value: int) -> None:
        """What a register's new value sets going."""
        if name == "torque_enable" and value and not before:
            self.motion.hold()
        elif name == "torque_limit" and value:
            self._fatal = 0
        elif name == "goal_position":
            self.table.put("torque_enable", 1)
            self.motion.approach()
        elif name == "moving_speed":
            # Also one that comes in one packet behind the goal, and ends a way at full speed (0).
            self.motion.approach()


def make_servo(model: Model, now: float = 0.0) -> Servo:
    """A servo of that model."""
    return AxServo(model, now) if model.protocol == 1 else Servo(model, now)
