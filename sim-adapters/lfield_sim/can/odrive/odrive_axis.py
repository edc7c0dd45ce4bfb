"""An ODrive axis: states, errors, watchdog and controllers of firmware 0.6.

Simplified: every calibration takes a second and succeeds; homing moves to a switch half a turn below the
power-up position and sets 0 there; a position filter is a trapezoid with the limits of the trajectory.
"""

from __future__ import annotations

import math

from lfield_sim.can.can_motor import CanMotor, Trajectory
from lfield_sim.can.odrive.cansimple_table import (
    AxisError,
    AxisState,
    ControlMode,
    InputMode,
    ProcedureResult,
)
from lfield_sim.state_log import Facts

#: Gain of the position loop in 1/s, speed of homing in turns/s, seconds of a calibration.
GAIN, HOMING_SPEED, CALIBRATION = 20.0, 0.5, 1.0
#: Factor above the speed limit that is an error; maximum temperature in degrees Celsius.
TOLERANCE, HOTTEST = 1.2, 100.0
#: rad/s below which a motor is at rest.
STILL = 0.05
#: Seconds at full torque without motion after which a motor has spun out.
SPINOUT_AFTER = 0.5
_CALIBRATIONS = frozenset(
    {
        AxisState.FULL_CALIBRATION,
        AxisState.MOTOR_CALIBRATION,
        AxisState.ENCODER_INDEX_SEARCH,
        AxisState.ENCODER_OFFSET_CALIBRATION,
    }
)


class OdriveAxis:
    """An axis in turns and turns per second. `active` are the present errors, `reason` is the cause of the
    last disarming.
    """

    def __init__(self, motor: CanMotor) -> None:
        self._motor = motor
        self._home = motor.angle / math.tau - 0.5
        self.reset()

    def reset(self) -> None:
        """Sets the state after a reboot: idle, position 0 at the present place."""
        self.state, self.result = AxisState.IDLE, ProcedureResult.SUCCESS
        self.active = self.reason = AxisError.NONE
        self._control, self._input = ControlMode.POSITION, InputMode.PASSTHROUGH
        self._profile = Trajectory()
        self._zero = self._motor.angle / math.tau
        self._speed_limit, self._current_limit = 20.0, 15.0
        self._trajectory = (5.0, 10.0, 10.0)
        self.ramp_rate = 10.0
        self.watching, self.watchdog = False, 0.0
        self._watchdog_time = self._busy = self._blocked = 0.0
        self._hold_position()

    @property
    def position(self) -> float:
        """The position of the axis in turns."""
        return self._motor.angle / math.tau - self._zero

    @property
    def velocity(self) -> float:
        """The velocity of the axis in turns/s."""
        return self._motor.speed / math.tau

    @property
    def heartbeat(self) -> tuple[int, int, int, int]:
        """Errors, state, result of the last procedure, whether the trajectory is done."""
        return self.active | self.reason, self.state, self.result, self._done

    def facts(self) -> Facts:
        """The log entries of the axis; `goal` is its input in thousandths, `errors` the cause of its
        disarming.
        """
        inputs = {
            ControlMode.TORQUE: self._torque,
            ControlMode.VELOCITY: self._velocity,
            ControlMode.POSITION: self._position,
        }
        return {
            "state": self.state.name,
            "control": self._control.name,
            "goal": round(1000.0 * inputs[self._control]),
            "moving": abs(self._motor.speed) > STILL,
            "errors": int(self.active | self.reason),
        }

    def request(self, state: int) -> None:
        """Enters a valid state unless an error forbids it."""
        self.feed()
        if state == AxisState.IDLE:
            self.result = ProcedureResult.CANCELLED if self.result is ProcedureResult.BUSY else self.result
            self.disarm()
            return
        if state not in set(AxisState):
            return
        if self.active or self.reason:
            self.result = ProcedureResult.DISARMED
            return
        self.state, self._busy, self._blocked = AxisState(state), 0.0, 0.0
        self.result = (
            ProcedureResult.SUCCESS if self.state is AxisState.CLOSED_LOOP_CONTROL else ProcedureResult.BUSY
        )
        self._hold_position()

    def set_mode(self, control: int, mode: int) -> None:
        """Sets control and input modes; unknown numbers are ignored."""
        if control in set(ControlMode) and mode in set(InputMode):
            self._control, self._input = ControlMode(control), InputMode(mode)
            self._profile = Trajectory(self.position, self.velocity)

    def set_position(self, position: float, velocity: float, torque: float) -> None:
        """Input_Pos with its feed-forwards."""
        self.feed()
        self._position, self._velocity, self._torque = position, velocity, torque
        self._done = False

    def set_velocity(self, velocity: float, torque: float) -> None:
        """Input_Vel with its feed-forward."""
        self.feed()
        self._velocity, self._torque = velocity, torque

    def set_torque(self, torque: float) -> None:
        """Input_Torque."""
        self.feed()
        self._torque = torque

    def set_limits(self, speed: float, current: float) -> None:
        """Sets limits of speed in turns/s and of the motor's current in amperes."""
        if speed >= 0.0 and current >= 0.0:
            self._speed_limit, self._current_limit = speed, current

    def set_trajectory_speed(self, speed: float) -> None:
        """Sets the trapezoid's speed."""
        if speed > 0.0:
            self._trajectory = (speed, *self._trajectory[1:])

    def set_trajectory_ramps(self, acceleration: float, deceleration: float) -> None:
        """Sets the trapezoid's ramps in turns/s2."""
        if acceleration > 0.0 and deceleration > 0.0:
            self._trajectory = (self._trajectory[0], acceleration, deceleration)

    def set_place(self, position: float) -> None:
        """Defines the present position."""
        self._position += position - self.position
        self._zero = self._motor.angle / math.tau - position
        self._profile = Trajectory(position, self.velocity)

    def feed(self) -> None:
        """Feeds the watchdog."""
        self._watchdog_time = 0.0

    def clear(self) -> None:
        """Clears errors; persisting ones return."""
        self.active = self.reason = AxisError.NONE
        self.feed()

    def disarm(self) -> None:
        """Enters idle."""
        self.state = AxisState.IDLE

    def fail(self, error: AxisError) -> None:
        """Disarms because of an error."""
        self.active |= error
        if self.state is not AxisState.IDLE:
            self.result = ProcedureResult.DISARMED
        self.reason |= error
        self.disarm()

    def step(self, dt: float) -> None:
        """Advances time: checks, state and motor."""
        if self._motor.temperature > HOTTEST:
            self.fail(AxisError.MOTOR_OVER_TEMP)
        if self.state is AxisState.CLOSED_LOOP_CONTROL:
            self._check(dt)
        if self.state is AxisState.CLOSED_LOOP_CONTROL:
            self._follow(dt)
        elif self.state is AxisState.HOMING:
            self._go_home(dt)
        else:
            self._motor.step_unpowered(dt)
        if self.state in _CALIBRATIONS:
            self._busy += dt
            if self._busy >= CALIBRATION:
                self._succeed()

    def _hold_position(self) -> None:
        """Sets inputs and reference to the present position."""
        self._position, self._velocity, self._torque = self.position, 0.0, 0.0
        self._profile = Trajectory(self.position, self.velocity)
        self._done = True

    def _check(self, dt: float) -> None:
        self._watchdog_time += dt
        if self.watching and self._watchdog_time > self.watchdog:
            self.fail(AxisError.WATCHDOG_TIMER_EXPIRED)
        if abs(self.velocity) > TOLERANCE * self._speed_limit + 0.01:
            self.fail(AxisError.VELOCITY_LIMIT_VIOLATION)
        blocked = self._motor.speed == 0.0 and abs(self._motor.torque) >= self._strongest > 0.0
        self._blocked = self._blocked + dt if blocked else 0.0
        if self._blocked > SPINOUT_AFTER:
            self.fail(AxisError.SPINOUT_DETECTED)

    @property
    def _strongest(self) -> float:
        """The torque limit in newton metres."""
        data = self._motor.data
        return min(self._current_limit * data.torque_constant, data.max_torque)

    def _follow(self, dt: float) -> None:
        if self._control is ControlMode.TORQUE:
            self._drive(dt)
        elif self._control is ControlMode.VELOCITY:
            rate = self.ramp_rate if self._input is InputMode.VEL_RAMP else math.inf
            self._profile.to_velocity(self._velocity, acceleration=rate, deceleration=rate, dt=dt)
            self._track(self._profile.velocity, dt)
        else:
            self._move(dt)

    def _drive(self, dt: float) -> None:
        torque = max(-self._strongest, min(self._strongest, self._torque))
        if abs(self.velocity) >= self._speed_limit and torque * self.velocity > 0.0:
            self._motor.track(math.copysign(self._speed_limit * math.tau, torque), dt, abs(torque))
        else:
            self._motor.drive(torque, dt)

    def _move(self, dt: float) -> None:
        if self._input in (InputMode.TRAP_TRAJ, InputMode.POS_FILTER):
            self._glide(self._position, *self._trajectory, dt)
            self._done = self._profile.position == self._position
        else:
            self._profile = Trajectory(self._position, self._velocity)
        error = self._profile.position - self.position
        self._track(self._profile.velocity + GAIN * error, dt)

    def _go_home(self, dt: float) -> None:
        home = self._home - self._zero
        self._glide(home, HOMING_SPEED, *self._trajectory[1:], dt)
        self._track(self._profile.velocity + GAIN * (self._profile.position - self.position), dt)
        is_at_home = self._profile.position == home and abs(self.position - home) < 1e-3
        if is_at_home and abs(self.velocity) < 1e-3:
            self.set_place(0.0)
            self._succeed()

    def _glide(
        self, target: float, speed: float, acceleration: float, deceleration: float, dt: float
    ) -> None:
        """Moves the reference one step along a trapezoid."""
        self._profile.to_position(
            target,
            speed=min(speed, self._speed_limit),
            acceleration=acceleration,
            deceleration=deceleration,
            dt=dt,
        )

    def _track(self, velocity: float, dt: float) -> None:
        bound = max(-self._speed_limit, min(self._speed_limit, velocity))
        self._motor.track(bound * math.tau, dt, self._strongest)

    def _succeed(self) -> None:
        self.result = ProcedureResult.SUCCESS
        self.disarm()
