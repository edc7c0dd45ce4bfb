"""The STS series of Feetech: packets of protocol 1.0 and sync reads, 4096 counts a turn, EEPROM with a lock.

Facts: the vendor's memory table and SDK (ftservo-python-sdk), and LeRobot's tables. Signs are a bit beside a
magnitude. A locked servo uses values that are written to its EEPROM until it loses power.
"""

from __future__ import annotations

import math

from lfield.errors import UsageError
from lfield_sim.dynamixel.control_table import ControlTable, InstructionRefused, RefusalCode
from lfield_sim.dynamixel.motion_profile import MotionProfile
from lfield_sim.dynamixel.servo import ANSWER_ALL, OVERHEATING, OVERLOAD, VOLTAGE_ERROR, VOLTAGE_TIME, Servo
from lfield_sim.dynamixel.servo_model import STS_BAUDS, Register, ServoModel
from lfield_sim.dynamixel.servo_motion import COUNTS, TURN, ServoMotion, catch_up

#: Bits of the status that are not those of a DYNAMIXEL servo.
ENCODER, OVERCURRENT = 0x02, 0x08
#: Errors that switch the torque off, if the unloading condition names them; an overload reduces it.
RELEASING = OVERHEATING | OVERCURRENT
#: Operating mode.
VELOCITY = 1
#: Value of the torque switch that makes the present position the middle.
RECENTRE = 128
#: Units: acceleration in counts/s2, times in s, torque limit and current.
ACCELERATION_UNIT, TIME_UNIT, WHOLE, CURRENT_UNIT = 100.0, 0.01, 1000.0, 0.0065
#: Bits of a sign.
OFFSET_SIGN, LOAD_SIGN, SIGN = 1 << 11, 1 << 10, 1 << 15


def magnitude(value: float, bit: int) -> int:
    """A value as a magnitude with a sign bit."""
    size = min(abs(round(value)), bit - 1)
    return size | bit if value < 0 and size else size


def signed(raw: int, bit: int) -> int:
    """The inverse of `magnitude`."""
    return -(raw & (bit - 1)) if raw & bit else raw


class StsMotion(ServoMotion):
    """Motion of an STS: trapezoids to a goal, or a velocity with a ramp. Other modes have no effect."""

    def __init__(self, model: ServoModel, table: ControlTable) -> None:
        self._wraps = 0
        #: Share of the torque that protection leaves.
        self.protection = 1.0
        super().__init__(model, table)

    @property
    def place(self) -> float:
        """Position of the shaft in counts: the homing offset is subtracted."""
        offset = signed(self.table["homing_offset"], OFFSET_SIGN)
        return self.motor.angle * COUNTS - offset + self._wraps * TURN

    @property
    def moving(self) -> bool:
        """Whether the servo turns, or moves to a goal."""
        return self.under_way or abs(self.motor.speed) * COUNTS > 1.0

    @property
    def under_way(self) -> bool:
        """Whether the servo moves to a goal."""
        return (
            bool(self.table["torque_enable"])
            and not self._is_velocity_mode
            and self.clock < self.profile.duration
        )

    @property
    def _is_velocity_mode(self) -> bool:
        return self.table["operating_mode"] == VELOCITY

    def single_turn(self) -> None:
        """Reduces the position to one turn."""
        self._wraps -= math.floor(self.place / TURN)
        self.resting = False

    def put_in(self, place: float) -> None:
        """Puts the shaft at a position, without moving."""
        self.motor.angle += (place - self.place) / COUNTS
        self.single_turn()
        self.hold()

    def reset_goals(self) -> None:
        """The goals after power-up."""
        self.table.put("torque_limit", self.table["max_torque"])
        self.single_turn()
        self.hold()

    def hold(self) -> None:
        """Sets the goal to the present position."""
        position = self.place
        self.table.put("goal_position", magnitude(position, SIGN))
        self.profile = MotionProfile(position, 0.0, position, math.inf, math.inf)
        self.clock, self.trajectory, self.trajectory_speed, self.resting = 0.0, position, 0.0, False

    def approach(self) -> None:
        """Plans the motion to the goal, within the limits, from its present position and speed."""
        goal = float(signed(self.table["goal_position"], SIGN))
        low, high = self.table["min_position_limit"], self.table["max_position_limit"]
        goal = min(max(goal, low), high) if low < high else goal
        place, speed = (self.trajectory, self.trajectory_speed) if self.under_way else (self.place, 0.0)
        max_speed = abs(signed(self.table["goal_velocity"], SIGN)) or math.inf
        rise = self.table["acceleration"] * ACCELERATION_UNIT or math.inf
        self.profile = MotionProfile(place, speed, goal, max_speed, rise)
        self.clock, self.resting = 0.0, False

    def step(self, dt: float) -> None:
        """Advances time by `dt` seconds."""
        motor, table = self.motor, self.table
        if self.resting or not table["torque_enable"]:
            motor.step_unpowered(dt)
            self.trajectory, self.trajectory_speed = self.place, 0.0
            self.resting = motor.speed == 0.0
            return
        self.clock += dt
        share = min(table["torque_limit"] / WHOLE, self.protection)
        motor.drive(motor.torque_for(self._speed(dt), dt), share, math.inf, dt)
        self.resting = self.is_settled()

    def _speed(self, dt: float) -> float:
        """The speed in rad/s that follows the profile, or the goal velocity."""
        if not self._is_velocity_mode:
            self.trajectory, self.trajectory_speed = self.profile.at(self.clock)
            return self.trajectory_speed / COUNTS + catch_up(
                (self.trajectory - self.place) / COUNTS, self.motor
            )
        change = self.table["acceleration"] * ACCELERATION_UNIT * dt or math.inf
        goal = signed(self.table["goal_velocity"], SIGN)
        self.trajectory_speed += max(-change, min(change, goal - self.trajectory_speed))
        return self.trajectory_speed / COUNTS

    def is_settled(self) -> bool:
        """Whether no value changes without a further write. Little torque may follow slowly, long after
        the profile.
        """
        follows = self._is_velocity_mode or abs(self.trajectory - self.place) < 1.0
        return super().is_settled() and follows

    def publish(self, time: float) -> None:
        """Writes the present-value registers."""
        motor, put = self.motor, self.table.put
        put("present_position", magnitude(round(self.place) % TURN, SIGN))
        put("present_velocity", magnitude(motor.speed * COUNTS, SIGN))
        put("present_load", magnitude(motor.duty * WHOLE, LOAD_SIGN))
        put("present_voltage", round(motor.voltage * 10.0))
        put("present_temperature", round(min(255.0, motor.temperature)))
        put("moving", int(self.moving))
        put("present_current", magnitude(motor.current / CURRENT_UNIT, SIGN))


class StsServo(Servo):
    """An STS: its status is the error byte of every answer. A refused write is answered as any other."""

    motion: StsMotion

    def __init__(self, model: ServoModel, now: float = 0.0) -> None:
        # Errors until the torque is switched on again; seconds for which a cause holds; values that are
        # saved, of registers that were written while locked.
        self._latched = 0
        self._cause_durations: dict[int, float] = {}
        self._saved: dict[str, int] = {}
        super().__init__(model, now)

    def make_motion(self) -> ServoMotion:
        """The motion model of an STS."""
        return StsMotion(self.model, self.table)

    @property
    def baud(self) -> int:
        """Bits per second."""
        return STS_BAUDS[self.table["baud_rate"]]

    @property
    def protocol(self) -> int:
        """Always 0, as in the vendor's SDK."""
        return 0

    @property
    def secondary(self) -> int | None:
        """None: an STS has no secondary id."""
        return None

    @property
    def alert(self) -> int:
        """The status of the servo."""
        return self.table["status"]

    def answers(self, level: int) -> bool:
        """Whether the servo answers: pings and reads always, other instructions if its status return level
        is 1.
        """
        return level < ANSWER_ALL or bool(self.table["status_return_level"])

    def start_with(self, id: int, baud: int, protocol: int, return_delay: float) -> None:
        """Sets id and baud rate. Raises UsageError if the model does not support them."""
        if baud not in STS_BAUDS:
            raise UsageError(f"{self.model.name} does not support {baud} baud")
        self.table.put("baud_rate", STS_BAUDS.index(baud))
        self.answer_as(id, return_delay)

    def calibrate(self, drive_mode: int, homing_offset: int, lowest: int, highest: int) -> None:
        """Sets the registers that a calibration sets; the shaft is in the middle of its range. No effect
        of `drive_mode`: clients apply it.
        """
        self.table.put("homing_offset", magnitude(homing_offset, OFFSET_SIGN))
        self.table.put("min_position_limit", lowest)
        self.table.put("max_position_limit", highest)
        self.motion.put_in((lowest + highest) / 2.0)

    def watch_bus(self) -> None:
        """Has no effect: an STS has no bus watchdog."""

    def protect(self, dt: float) -> None:
        """Updates the status, and reduces or switches off the torque by the unloading condition."""
        errors = self.errors(dt)
        self._latched |= errors & self.table["unloading_condition"] & (RELEASING | OVERLOAD)
        if self._latched & RELEASING:
            self.table.put("torque_enable", 0)
        is_overloaded = self._latched & OVERLOAD
        self.motion.protection = self.table["protective_torque"] / 100.0 if is_overloaded else 1.0
        self.table.put("status", errors | self._latched)

    def errors(self, dt: float) -> int:
        """Present errors, as bits of the status."""
        table, motor = self.table, self.motion.motor
        load = abs(motor.current) / motor.strength.stall_current * 100.0
        causes = {
            VOLTAGE_ERROR: (
                not table["min_voltage_limit"] <= motor.voltage * 10.0 <= table["max_voltage_limit"],
                VOLTAGE_TIME,
            ),
            OVERCURRENT: (
                abs(motor.current) / CURRENT_UNIT > table["protection_current"],
                table["over_current_time"] * TIME_UNIT,
            ),
            OVERLOAD: (load >= table["overload_torque"], table["protection_time"] * TIME_UNIT),
        }
        self._cause_durations = {
            bit: self._cause_durations.get(bit, 0.0) + dt if is_present else 0.0
            for bit, (is_present, _) in causes.items()
        }
        errors = sum(bit for bit, (_, tolerated) in causes.items() if self._cause_durations[bit] > tolerated)
        errors |= OVERHEATING if motor.temperature > table["temperature_limit"] else 0
        return errors | (ENCODER if self.encoder_fault else 0)

    def reboot(self) -> None:
        """Restarts as after power-up: values that were written while the servo was locked are lost."""
        self.table.reset(eeprom=False)
        for name, value in self._saved.items():
            self.table.put(name, value)
        self._saved, self._latched, self._cause_durations = {}, 0, {}
        self.restart()

    def check(self, item: Register, value: int, secondary: bool) -> None:
        """Raises InstructionRefused: a register is read-only, or the value is invalid."""
        if not item.writable:
            raise InstructionRefused(RefusalCode.ACCESS)
        if not item.low <= value <= item.high or (item.choices and value not in item.choices):
            raise InstructionRefused(RefusalCode.RANGE)

    def follow_up(self, name: str, before: int, value: int) -> None:
        """Applies the effects of a register's new value."""
        if self.model.items[name].eeprom:
            self._on_eeprom(name, before)
        if name == "torque_enable":
            self._on_torque_switch(before, value)
        elif name in ("homing_offset", "operating_mode"):
            self.motion.single_turn()
            self.motion.hold()
        elif name == "goal_position" and not self._latched & RELEASING:
            self.table.put("torque_enable", 1)
            self.motion.approach()
        elif name == "goal_velocity":
            # Also after the goal in one packet.
            self.motion.approach()

    def _on_eeprom(self, name: str, before: int) -> None:
        if self.table["lock"]:
            self._saved.setdefault(name, before)
        else:
            self._saved.pop(name, None)

    def _on_torque_switch(self, before: int, value: int) -> None:
        if value == RECENTRE:
            offset = round(self.motion.place) + signed(self.table["homing_offset"], OFFSET_SIGN) - TURN // 2
            self.table.put("homing_offset", magnitude(offset, OFFSET_SIGN))
            self.table.put("torque_enable", before)
            self.motion.single_turn()
        elif value:
            self._latched, self._cause_durations = 0, {}
        if value and not before:
            self.motion.hold()
