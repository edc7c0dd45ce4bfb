"""What an ODrive axis does: states, errors, watchdog and its controllers, as its firmware 0.6 has them.

Simplified: every calibration takes a second and succeeds; homing travels to a switch half a turn below where
the axis woke up and makes that place 0; a position filter is a trapezoid with the limits of the trajectory.
"""

from __future__ import annotations

import math

from lfield_sim.can.motor import Motor, Trajectory
from lfield_sim.can.odrive.table import Control, Error, Input, Result, State
from lfield_sim.state_log import Facts

#: Gain of the position loop in 1/s, speed of homing in turns/s, seconds of a calibration.
GAIN, HOMING_SPEED, CALIBRATION = 20.0, 0.5, 1.0
#: Faster than the limit by this factor is an error; hotter than this in degrees Celsius too.
TOLERANCE, HOTTEST = 1.2, 100.0
#: A motor slower than this stands, in rad/s.
STILL = 0.05
#: A motor that does not turn at its full torque has spun out after this long, in seconds.
SPINOUT_AFTER = 0.5
_CALIBRATIONS = frozenset(
    {
        State.FULL_CALIBRATION,
        State.MOTOR_CALIBRATION,
        State.ENCODER_INDEX_SEARCH,
        State.ENCODER_OFFSET_CALIBRATION,
    }
)


class OdriveAxis:
    """Turns and turns per second. `active` are the errors there are, `reason` why it was disarmed."""

    def __init__(self, motor: Motor) -> None:
        self._motor = motor
        self._home = motor.angle / math.tau - 0.5
        self.reset()

    def reset(self) -> None:
        """As after a reboot: idle, position 0 where it stands."""
        self.state, self.result = State.IDLE, Result.SUCCESS
        self.active = self.reason = Error.NONE
        self._control, self._input = Control.POSITION, Input.PASSTHROUGH
        self._profile = Trajectory()
        self._zero = self._motor.angle / math.tau
        self._speed_limit, self._current_limit = 20.0, 15.0
        self._trajectory = (5.0, 10.0, 10.0)
        self.ramp_rate = 10.0
        self.watching, self.watchdog = False, 0.0
        self._unfed = self._busy = self._blocked = 0.0
        self._rest()

    @property
    def position(self) -> float:
        """Where it is, in turns."""
        return self._motor.angle / math.tau - self._zero

    @property
    def velocity(self) -> float:
        """How fast it turns, in turns/s."""
        return self._motor.speed / math.tau

    @property
    def heartbeat(self) -> tuple[int, int, int, int]:
        """Errors, state, result of the last procedure, whether the trajectory is done."""
        return self.active | self.reason, self.state, self.result, self._done

    def facts(self) -> Facts:
        """What it writes into its log; `goal` is its input in thousandths, `errors` why it was disarmed."""
        inputs = {
            Control.TORQUE: self._torque,
            Control.VELOCITY: self._velocity,
            Control.POSITION: self._position,
        }
        return {
            "state": self.state.name,
            "control": self._control.name,
            "goal": round(1000.0 * inputs[self._control]),
            "moving": abs(self._motor.speed) > STILL,
            "errors": int(self.active | self.reason),
        }

    def request(self, state: int) -> None:
        """Go to a state, if it is one and no error forbids it."""
        self.feed()
        if state == State.IDLE:
            self.result = Result.CANCELLED if self.result is Result.BUSY else self.result
            self.disarm()
            return
        if state not in set(State):
            return
        if self.active or self.reason:
            self.result = Result.DISARMED
            return
        self.state, self._busy, self._blocked = State(state), 0.0, 0.0
        self.result = Result.SUCCESS if self.state is State.CLOSED_LOOP_CONTROL else Result.BUSY
        self._rest()

    def set_mode(self, control: int, mode: int) -> None:
        """What to control, and how inputs become setpoints; unknown numbers are ignored."""
        if control in set(Control) and mode in set(Input):
            self._control, self._input = Control(control), Input(mode)
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
        """Of speed in turns/s and of the motor's current in amperes."""
        if speed >= 0.0 and current >= 0.0:
            self._speed_limit, self._current_limit = speed, current

    def set_trajectory_speed(self, speed: float) -> None:
        """Of the trapezoid."""
        if speed > 0.0:
            self._trajectory = (speed, *self._trajectory[1:])

    def set_trajectory_ramps(self, up: float, down: float) -> None:
        """Of the trapezoid, in turns/s2."""
        if up > 0.0 and down > 0.0:
            self._trajectory = (self._trajectory[0], up, down)

    def set_place(self, position: float) -> None:
        """Let the place where it stands be this one."""
        self._position += position - self.position
        self._zero = self._motor.angle / math.tau - position
        self._profile = Trajectory(position, self.velocity)

    def feed(self) -> None:
        """Feed the watchdog."""
        self._unfed = 0.0

    def clear(self) -> None:
        """Forget errors; what still is wrong comes back."""
        self.active = self.reason = Error.NONE
        self.feed()

    def disarm(self) -> None:
        """Go idle."""
        self.state = State.IDLE

    def fail(self, error: Error) -> None:
        """Disarm because of an error."""
        self.active |= error
        if self.state is not State.IDLE:
            self.result = Result.DISARMED
        self.reason |= error
        self.disarm()

    def step(self, dt: float) -> None:
        """Let time pass: checks, state and motor."""
        if self._motor.temperature > HOTTEST:
            self.fail(Error.MOTOR_OVER_TEMP)
        if self.state is State.CLOSED_LOOP_CONTROL:
            self._check(dt)
        if self.state is State.CLOSED_LOOP_CONTROL:
            self._follow(dt)
        elif self.state is State.HOMING:
            self._go_home(dt)
        else:
            self._motor.rest(dt)
        if self.state in _CALIBRATIONS:
            self._busy += dt
            if self._busy >= CALIBRATION:
                self._succeed()

    def _rest(self) -> None:
        """Inputs and reference where the axis stands."""
        self._position, self._velocity, self._torque = self.position, 0.0, 0.0
        self._profile = Trajectory(self.position, self.velocity)
        self._done = True

    def _check(self, dt: float) -> None:
        self._unfed += dt
        if self.watching and self._unfed > self.watchdog:
            self.fail(Error.WATCHDOG_TIMER_EXPIRED)
        if abs(self.velocity) > TOLERANCE * self._speed_limit + 0.01:
            self.fail(Error.VELOCITY_LIMIT_VIOLATION)
        blocked = self._motor.speed == 0.0 and abs(self._motor.torque) >= self._strongest > 0.0
        self._blocked = self._blocked + dt if blocked else 0.0
        if self._blocked > SPINOUT_AFTER:
            self.fail(Error.SPINOUT_DETECTED)

    @property
    def _strongest(self) -> float:
        """The bound of the torque, in newton metres."""
        data = self._motor.data
        return min(self._current_limit * data.torque_constant, data.max_torque)

    def _follow(self, dt: float) -> None:
        if self._control is Control.TORQUE:
            self._drive(dt)
        elif self._control is Control.VELOCITY:
            rate = self.ramp_rate if self._input is Input.VEL_RAMP else math.inf
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
        if self._input in (Input.TRAP_TRAJ, Input.POS_FILTER):
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
        there = self._profile.position == home and abs(self.position - home) < 1e-3
        if there and abs(self.velocity) < 1e-3:
            self.set_place(0.0)
            self._succeed()

    def _glide(self, target: float, speed: float, up: float, down: float, dt: float) -> None:
        """The reference one step along a trapezoid."""
        self._profile.to_position(
            target, speed=min(speed, self._speed_limit), acceleration=up, deceleration=down, dt=dt
        )

    def _track(self, velocity: float, dt: float) -> None:
        bound = max(-self._speed_limit, min(self._speed_limit, velocity))
        self._motor.track(bound * math.tau, dt, self._strongest)

    def _succeed(self) -> None:
        self.result = Result.SUCCESS
        self.disarm()
