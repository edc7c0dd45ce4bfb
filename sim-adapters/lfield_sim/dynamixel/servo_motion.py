"""Motion of a servo from its goals: operating modes, profiles, position loop, and present-value registers.

https://emanual.robotis.com/docs/en/dxl/x/xm430-w350/, registers 10, 11, 20 and 100 to 146. Positions are
counts in the register's frame (after direction and homing offset), like the profile.
"""

from __future__ import annotations

import math

from lfield_sim.dynamixel.control_table import ControlTable
from lfield_sim.dynamixel.motion_profile import STEP, MotionProfile, timed
from lfield_sim.dynamixel.servo_model import (
    CURRENT,
    CURRENT_POSITION,
    EXTENDED,
    POSITION,
    PWM,
    VELOCITY,
    ServoModel,
)
from lfield_sim.dynamixel.servo_motor import ServoMotor

#: Counts per turn, and per radian.
TURN = 4096
COUNTS = TURN / (2.0 * math.pi)
#: rad/s per count of velocity (0.229 rev/min), rad/s2 per count of acceleration (214.577 rev/min2).
VELOCITY_UNIT = 0.229 * 2.0 * math.pi / 60.0
ACCELERATION_UNIT = 214.577 * 2.0 * math.pi / 3600.0
FULL_PWM = 885

#: Bits of Drive Mode. A slave follows the sync cable of its master and ignores goals (XM540).
REVERSE, SLAVE, TIME_BASED = 0x01, 0x02, 0x04
#: Bits of Moving Status, and their tolerance in counts.
IN_POSITION, ONGOING, FOLLOWING_ERROR = 0x01, 0x02, 0x08
NEAR, ASTRAY = 5.0, 100.0
#: Gain of the position loop, in 1/s.
GAIN = 40.0
#: Larger homing offsets are ignored in position mode.
SMALL_OFFSET = 1024


def catch_up(error: float, motor: ServoMotor) -> float:
    """The speed, in rad/s, that corrects a position error in rad.

    Limited by braking, so that a distant goal without a profile is not overshot.
    """
    return math.copysign(min(GAIN * abs(error), math.sqrt(2.0 * motor.max_acceleration * abs(error))), error)


class ServoMotion:
    """Motion of one servo. `resting`: no value changes until a write."""

    def __init__(self, model: ServoModel, table: ControlTable) -> None:
        self.motor = ServoMotor(model.strength)
        self.resting = False
        self.table, self._unit = table, model.strength.unit
        self.profile = MotionProfile(0.0, 0.0, 0.0, math.inf, math.inf)
        self.clock = 0.0
        self.trajectory, self.trajectory_speed = 0.0, 0.0
        self.motor.angle = TURN / 2 / COUNTS
        # After power-up a servo is within one turn, in its direction.
        self._turns, self._turns_direction = 0, 1

    @property
    def _direction(self) -> int:
        return -1 if self.table["drive_mode"] & REVERSE else 1

    @property
    def _offset(self) -> int:
        offset = self.table["homing_offset"]
        ignored = self.table["operating_mode"] == POSITION and abs(offset) > SMALL_OFFSET
        return 0 if ignored else offset

    @property
    def place(self) -> float:
        """Position of the shaft in counts. The sign of the offset is independent of the direction."""
        if self._turns_direction != self._direction:
            self.single_turn()
        return self._direction * self.motor.angle * COUNTS + self._turns * TURN + self._offset

    @property
    def speed(self) -> float:
        """Speed of the shaft, in counts of velocity."""
        return self._direction * self.motor.speed / VELOCITY_UNIT

    @property
    def moving(self) -> bool:
        """Whether the servo is faster than the threshold, or moves to a goal."""
        return abs(self.speed) > self.table["moving_threshold"] or self.under_way

    @property
    def _positioned(self) -> bool:
        return self.table["operating_mode"] in (POSITION, EXTENDED, CURRENT_POSITION)

    @property
    def under_way(self) -> bool:
        """Whether the servo moves to a goal."""
        return self._is_driven and self._positioned and self.clock < self.profile.duration

    @property
    def _is_driven(self) -> bool:
        """Whether the motor follows the servo's own goals."""
        return bool(self.table["torque_enable"]) and not self.table["drive_mode"] & SLAVE

    def single_turn(self) -> None:
        """Clears the turns: the position without offset is within one."""
        self.motor.angle %= 2.0 * math.pi
        self._turns_direction = self._direction
        self._turns = 1 if self._direction < 0 and self.motor.angle > 0.0 else 0
        self.resting = False

    def put_in(self, place: float) -> None:
        """Puts the shaft at a position in counts, without moving."""
        self.motor.angle += self._direction * (place - self.place) / COUNTS
        self.single_turn()
        self.hold()

    def reset_goals(self) -> None:
        """The goals after power-up, or a change of mode."""
        table = self.table
        table.put("goal_pwm", table["pwm_limit"])
        table.put("goal_velocity", 0)
        if "goal_current" in table:
            mode = table["operating_mode"]
            table.put("goal_current", table["current_limit"] if mode == CURRENT_POSITION else 0)
        self.hold()

    def hold(self) -> None:
        """Sets the goal to the present position: at torque on, and when the watchdog stops the servo."""
        position = self.place
        self.table.put("goal_position", round(position))
        self.profile = MotionProfile(position, 0.0, position, math.inf, math.inf)
        self.clock, self.trajectory, self.trajectory_speed = 0.0, position, 0.0
        self.resting = False

    def stop(self) -> None:
        """Stops at once, without a profile."""
        self.table.put("goal_velocity", 0)
        self.table.put("goal_pwm", 0 if self.table["operating_mode"] == PWM else self.table["goal_pwm"])
        if self.table["operating_mode"] == CURRENT:
            self.table.put("goal_current", 0)
        self.hold()

    def approach(self) -> None:
        """Plans the motion to the goal from the present position and speed."""
        goal = float(self.table["goal_position"])
        place, speed = (self.trajectory, self.trajectory_speed) if self.under_way else (self.place, 0.0)
        self.profile = MotionProfile(place, speed, goal, *self._bounds(goal - place))
        self.clock, self.resting = 0.0, False

    def _bounds(self, distance: float) -> tuple[float, float]:
        """Maximum speed and acceleration of a profile, in counts and seconds."""
        fastest, rising = self.table["profile_velocity"], self.table["profile_acceleration"]
        if not fastest:
            return math.inf, math.inf
        if self.table["drive_mode"] & TIME_BASED:
            return timed(distance, fastest / 1000.0, rising / 1000.0) if distance else (math.inf, math.inf)
        acceleration = rising * ACCELERATION_UNIT * COUNTS if rising else math.inf
        return fastest * VELOCITY_UNIT * COUNTS, acceleration

    def step(self, dt: float) -> None:
        """Advances time by `dt` seconds."""
        if self.resting or not self._is_driven:
            self.motor.step_unpowered(dt)
            self.trajectory, self.trajectory_speed = self.place, 0.0
            self.resting = self.motor.speed == 0.0
            return
        self.clock += dt
        torque, duty, current = self._demand(dt)
        self.motor.drive(torque, duty, current, dt)
        self.resting = self.is_settled()

    def is_settled(self) -> bool:
        """Whether no value changes without a further write."""
        motor = self.motor
        still = abs(motor.speed) < 1e-4 and abs(motor.current) < 1e-3 and motor.load == 0.0
        return (
            still
            and not self.under_way
            and self.trajectory_speed == 0.0
            and not (motor.blocked or motor.slipping)
        )

    def _demand(self, dt: float) -> tuple[float, float, float]:
        """Torque, share of the supply and current for the mode."""
        mode, motor = self.table["operating_mode"], self.motor
        share = self.table["goal_pwm"] / FULL_PWM
        if mode == PWM:
            return motor.torque_at(self._direction * share), 1.0, math.inf
        if mode == CURRENT:
            amperes = self._direction * self.table["goal_current"] * self._unit
            return (
                amperes * motor.strength.stall_torque / motor.strength.stall_current,
                abs(share),
                self._max_current(),
            )
        speed = self._ramp(dt) if mode == VELOCITY else self._follow()
        return motor.torque_for(self._direction * speed, dt), abs(share), self._max_current()

    def _max_current(self) -> float:
        """The maximum current of the mode, in A."""
        if not self._unit:
            return math.inf
        register = "goal_current" if self.table["operating_mode"] == CURRENT_POSITION else "current_limit"
        return abs(self.table[register]) * self._unit

    def _follow(self) -> float:
        """The speed in rad/s for the profile."""
        self.trajectory, self.trajectory_speed = self.profile.at(self.clock)
        return self.trajectory_speed / COUNTS + catch_up((self.trajectory - self.place) / COUNTS, self.motor)

    def _ramp(self, dt: float) -> float:
        """The speed in rad/s, in the register's direction, on the ramp to the goal velocity."""
        goal = self.table["goal_velocity"] * VELOCITY_UNIT * COUNTS
        rising = self.table["profile_acceleration"]
        if not rising:
            self.trajectory_speed = goal
        elif self.table["drive_mode"] & TIME_BASED:
            remaining = max(dt, rising / 1000.0 - self.clock + dt)
            self.trajectory_speed += (goal - self.trajectory_speed) * min(1.0, dt / remaining)
        else:
            change = rising * ACCELERATION_UNIT * COUNTS * dt
            self.trajectory_speed += max(-change, min(change, goal - self.trajectory_speed))
        self.trajectory = self.place
        return self.trajectory_speed / COUNTS

    def accelerate(self) -> None:
        """Starts the ramp to a new goal velocity."""
        self.clock, self.resting = 0.0, False

    def publish(self, time: float) -> None:
        """Writes the present-value registers; `time` is seconds since power-up."""
        motor, put = self.motor, self.table.put
        put("realtime_tick", int(time * 1000.0) % 32_768)
        put("moving", int(self.moving))
        put("moving_status", self._status())
        put("present_pwm", round(self._direction * motor.duty * FULL_PWM))
        put("present_velocity", round(self.speed))
        put("present_position", round(self.place))
        put("velocity_trajectory", round(self.trajectory_speed / COUNTS / VELOCITY_UNIT))
        put("position_trajectory", round(self.trajectory))
        put("present_input_voltage", round(motor.voltage * 10.0))
        put("present_temperature", round(min(255.0, motor.temperature)))
        count = self._unit or motor.strength.stall_current / 1000.0
        put("present_current", round(self._direction * motor.current / count))

    def _status(self) -> int:
        if not self._positioned or not self.table["torque_enable"]:
            return 0
        ongoing, place = self.under_way, self.place
        status = (self.profile.kind | ONGOING) if ongoing else STEP
        status |= IN_POSITION if abs(self.table["goal_position"] - place) <= NEAR else 0
        return status | (FOLLOWING_ERROR if abs(self.trajectory - place) > ASTRAY else 0)
