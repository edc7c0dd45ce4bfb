"""The AX series: protocol 1.0, 300 degrees in 1023 counts, joint and wheel mode.

https://emanual.robotis.com/docs/en/dxl/ax/ax-12a/
"""

from __future__ import annotations

import math

from lfield.errors import UsageError
from lfield_sim.dynamixel.control_table import ControlTable, InstructionRefused, RefusalCode
from lfield_sim.dynamixel.motion_profile import MotionProfile
from lfield_sim.dynamixel.servo import ERRORS_1, Servo
from lfield_sim.dynamixel.servo_model import Register, ServoModel
from lfield_sim.dynamixel.servo_motion import ServoMotion, catch_up
from lfield_sim.dynamixel.sts_series import StsServo

#: Counts per radian, and the middle position.
COUNTS, MIDDLE = 1023.0 / math.radians(300.0), 512
#: rad/s per count of speed (0.111 rev/min).
SPEED_UNIT = 0.111 * math.tau / 60.0
#: Maximum of torque, and of speed in wheel mode; the bit above it means clockwise.
FULL, CLOCKWISE = 1023, 0x400
#: Bits per second, times the register Baud Rate plus one.
BAUD_BASE = 2_000_000


class AxMotion(ServoMotion):
    """Motion of an AX: constant speed to its goal, or wheel mode when both angle limits are 0."""

    def __init__(self, model: ServoModel, table: ControlTable) -> None:
        super().__init__(model, table)
        self.motor.angle = MIDDLE / COUNTS

    @property
    def wheel(self) -> bool:
        """Whether the servo is in wheel mode."""
        return self.table["cw_angle_limit"] == self.table["ccw_angle_limit"] == 0

    @property
    def place(self) -> float:
        """Position of the shaft in counts."""
        return self.motor.angle * COUNTS

    @property
    def moving(self) -> bool:
        """Whether the servo moves to a goal, or turns."""
        return self.under_way or abs(self.motor.speed) > SPEED_UNIT

    @property
    def under_way(self) -> bool:
        """Whether the servo moves to a goal."""
        return bool(self.table["torque_enable"]) and not self.wheel and self.clock < self.profile.duration

    def single_turn(self) -> None:
        """Has no effect on the position: an AX has one turn only."""
        self.resting = False

    def reset_goals(self) -> None:
        """The goals after power-up."""
        self.table.put("moving_speed", 0)
        self.table.put("torque_limit", self.table["max_torque"])
        self.hold()

    def approach(self) -> None:
        """Plans the motion to the goal from the present position."""
        speed = self.table["moving_speed"] % CLOCKWISE * SPEED_UNIT * COUNTS
        goal = float(self.table["goal_position"])
        self.profile = MotionProfile(self.place, 0.0, goal, speed or math.inf, math.inf)
        self.clock, self.resting = 0.0, False

    def step(self, dt: float) -> None:
        """Advances time by `dt` seconds."""
        motor, share = self.motor, self.table["torque_limit"] / FULL
        if self.resting or not self.table["torque_enable"]:
            motor.step_unpowered(dt)
            self.resting = motor.speed == 0.0
            return
        self.clock += dt
        if self.wheel:
            motor.drive(motor.torque_at(self._wheel_share()), share, math.inf, dt)
        else:
            self.trajectory, self.trajectory_speed = self.profile.at(self.clock)
            speed = self.trajectory_speed / COUNTS + catch_up((self.trajectory - self.place) / COUNTS, motor)
            motor.drive(motor.torque_for(speed, dt), share, math.inf, dt)
        self.resting = self.is_settled()

    def _wheel_share(self) -> float:
        speed = self.table["moving_speed"]
        return (speed % CLOCKWISE) / FULL * (-1.0 if speed & CLOCKWISE else 1.0)

    def is_settled(self) -> bool:
        """Whether no value changes without a further write."""
        return super().is_settled() and not (self.wheel and self.table["moving_speed"] % CLOCKWISE)

    def publish(self, time: float) -> None:
        """Writes the present-value registers."""
        motor, put = self.motor, self.table.put
        put("present_position", round(min(1023.0, max(0.0, self.place % (math.tau * COUNTS)))))
        put("present_speed", _directed(motor.speed / SPEED_UNIT))
        put("present_load", _directed(motor.current / motor.strength.stall_current * FULL))
        put("present_voltage", round(motor.voltage * 10.0))
        put("present_temperature", round(min(255.0, motor.temperature)))
        put("moving", int(self.moving))


def _directed(value: float) -> int:
    """Magnitude, and a direction bit."""
    return min(FULL, abs(round(value))) | (CLOCKWISE if value <= -0.5 else 0)


class AxServo(Servo):
    """An AX: it reports present errors in every answer, and has no torque after a shutdown."""

    def __init__(self, model: ServoModel, now: float = 0.0) -> None:
        # Present errors, and the cause of a shutdown, which is reported until Torque Limit is written.
        self._reported_errors = self._shutdown_errors = 0
        super().__init__(model, now)

    def make_motion(self) -> ServoMotion:
        """The motion model of an AX."""
        return AxMotion(self.model, self.table)

    @property
    def baud(self) -> int:
        """Bits per second."""
        return round(BAUD_BASE / (self.table["baud_rate"] + 1))

    @property
    def protocol(self) -> int:
        """Always 1."""
        return 1

    @property
    def secondary(self) -> int | None:
        """None: an AX has no secondary id."""
        return None

    @property
    def alert(self) -> int:
        """The present errors."""
        return self._reported_errors & ERRORS_1

    def start_with(self, id: int, baud: int, protocol: int, return_delay: float) -> None:
        """Sets id, baud rate and protocol. Raises UsageError if the model does not support them."""
        if protocol != 1 or not BAUD_BASE / 255 <= baud <= BAUD_BASE / 2:
            raise UsageError(f"{self.model.name} does not support protocol {protocol}.0 at {baud} baud")
        self.table.put("baud_rate", round(BAUD_BASE / baud) - 1)
        self.answer_as(id, return_delay)

    def watch_bus(self) -> None:
        """Has no effect: an AX has no bus watchdog."""

    def protect(self, dt: float) -> None:
        """Updates errors, and switches the torque off for those in Shutdown."""
        errors = self.errors(dt)
        self._shutdown_errors |= errors & self.table["shutdown"]
        self._reported_errors = errors | self._shutdown_errors
        if errors & self.table["shutdown"]:
            self.table.put("torque_enable", 0)
            self.table.put("torque_limit", 0)

    def reboot(self) -> None:
        """Restarts as after power-up; only the factory reset does that."""
        self.table.reset(eeprom=False)
        self._reported_errors = self._shutdown_errors = 0
        self.restart()

    def check(self, item: Register, value: int, secondary: bool) -> None:
        """Raises InstructionRefused: a register is read-only, or the value is invalid."""
        if not item.writable or (item.eeprom and self.table["lock"]):
            raise InstructionRefused(RefusalCode.ACCESS)
        if not item.low <= value <= item.high or (item.name == "lock" and value < self.table["lock"]):
            raise InstructionRefused(RefusalCode.RANGE)
        if item.name == "goal_position" and not self.allows_goal(value):
            raise InstructionRefused(RefusalCode.LIMIT)

    def allows_goal(self, place: int) -> bool:
        """Whether a goal is between the angle limits; wheel mode has none."""
        table = self.table
        wheel = table["cw_angle_limit"] == table["ccw_angle_limit"] == 0
        return wheel or table["cw_angle_limit"] <= place <= table["ccw_angle_limit"]

    def follow_up(self, name: str, before: int, value: int) -> None:
        """Applies the effects of a register's new value."""
        if name == "torque_enable" and value and not before:
            self.motion.hold()
        elif name == "torque_limit" and value:
            self._shutdown_errors = 0
        elif name == "goal_position":
            self.table.put("torque_enable", 1)
            self.motion.approach()
        elif name == "moving_speed":
            # Also a value after the goal in one packet, such as full speed (0).
            self.motion.approach()


def make_servo(model: ServoModel, now: float = 0.0) -> Servo:
    """Creates a servo of that model."""
    return {0: StsServo, 1: AxServo}.get(model.protocol, Servo)(model, now)
