"""One axis of a CiA 402 drive: its states, its faults and its motor (CiA 402-2). Pure; stepped by time."""

from __future__ import annotations

import math
from collections.abc import Callable

from lfield_sim.can.modes402 import MODES, Mode
from lfield_sim.can.motor import Motor
from lfield_sim.can.objects402 import TEMPERATURE
from lfield_sim.can.sdo import ObjectDictionary
from lfield_sim.can.states402 import POWERED, TRANSITIONS, Command, State, command
from lfield_sim.can.trajectory import Trajectory

#: The gain of the position loop in 1/s, and seconds from power to SWITCH ON DISABLED.
GAIN, START_UP = 20.0, 0.05
#: A motor slower than this stands, in rad/s.
STILL = 0.05
#: The home switch is this far below where the drive wakes up, in radians.
HOME_BELOW = math.pi
HOT, HOTTEST = 80.0, 100.0

#: Error codes (0x603F) with their bits in the error register (0x1001).
OVERCURRENT, OVERHEAT, FOLLOWING = (0x2310, 0x02), (0x4310, 0x08), (0x8611, 0x20)
BLOCKED = (0x7121, 0x20)
#: A motor that does not turn at its full torque is blocked after this long, in seconds.
BLOCKED_FOR = 0.5
_GENERIC = 0x01
_FAULT_RESET, _HALT = 0x80, 0x100
_VOLTAGE, _WARNING, _REMOTE = 0x10, 0x80, 0x200


class Axis:
    """`report(code, register)` sends an emergency."""

    def __init__(self, objects: ObjectDictionary, motor: Motor, report: Callable[[int, int], None]) -> None:
        self.objects, self.motor, self._report = objects, motor, report
        self.home = motor.angle - HOME_BELOW
        #: Increments per radian.
        self.scale = objects.get(0x608F, 1) / math.tau
        objects.watch(self._written)
        self.reset()

    def reset(self) -> None:
        """As after power-up: the encoder counts from where the motor stands."""
        self.state = State.NOT_READY
        self.profile = Trajectory()
        self.mode: Mode = MODES[0]()
        self.word = 0
        self.origin = self.motor.angle
        self.torque_demand = 0.0
        self._waited = self._off_track = self._blocked = 0.0
        self._cause: Callable[[], bool] = lambda: False

    @property
    def position(self) -> float:
        """Where the motor is, in increments."""
        return (self.motor.angle - self.origin) * self.scale

    @property
    def velocity(self) -> float:
        """How fast it turns, in increments per second."""
        return self.motor.speed * self.scale

    @property
    def halted(self) -> bool:
        """Whether the controlword asks for a halt."""
        return bool(self.word & _HALT)

    @property
    def fastest(self) -> float:
        """The bound on every speed, in increments per second."""
        top = self.objects.get(0x6080) / 60.0 * math.tau * self.scale
        return min(top, self.objects.get(0x607F), self.motor.data.max_speed * self.scale)

    @property
    def strongest(self) -> float:
        """The bound on every torque, in newton metres."""
        share = min(self.objects.get(index) for index in (0x6072, 0x6073, 0x60E0, 0x60E1))
        return min(share / 1000.0 * self.motor.data.rated_torque, self.motor.data.max_torque)

    @property
    def home_position(self) -> float:
        """Where the home switch is, in increments as they count now."""
        return (self.home - self.origin) * self.scale

    def within(self, target: float) -> float:
        """A target position inside the software limits (0x607D), if there are any."""
        low, high = self.objects.get(0x607D, 1), self.objects.get(0x607D, 2)
        return max(low, min(high, target)) if low < high else target

    def follow(self, dt: float) -> None:
        """Drive the motor after the reference position, and watch how far it stays behind."""
        error = self.profile.position - self.position
        self.motor.track((self.profile.velocity + GAIN * error) / self.scale, dt, self.strongest)
        behind = abs(error) > self.objects.get(0x6065)
        self._off_track = self._off_track + dt if behind else 0.0
        if self._off_track > self.objects.get(0x6066) / 1000.0:
            self.fail(FOLLOWING)

    def ramp(self, velocity: float, dt: float, *, acceleration: float, deceleration: float) -> None:
        """Drive the motor after a reference velocity; the reference position goes with the motor."""
        self.profile.to_velocity(velocity, acceleration=acceleration, deceleration=deceleration, dt=dt)
        self.motor.track(self.profile.velocity / self.scale, dt, self.strongest)
        self.profile.position = self.position
        blocked = self.motor.speed == 0.0 and abs(self.motor.torque) >= self.strongest > 0.0
        self._blocked = self._blocked + dt if blocked else 0.0
        if self._blocked > BLOCKED_FOR:
            self.fail(BLOCKED)

    def brake(self, dt: float, *, deceleration: float) -> None:
        """Ramp down to rest, and stay there."""
        self.ramp(0.0, dt, acceleration=deceleration, deceleration=deceleration)

    def set_position(self, increments: float) -> None:
        """Let the place where the motor stands be this one (homing)."""
        self.origin = self.motor.angle - increments / self.scale
        self.profile = Trajectory(increments)

    def fail(self, error: tuple[int, int], cause: Callable[[], bool] = lambda: False) -> None:
        """Go to FAULT, after stopping where the power stage still can; `cause` tells while it lasts."""
        if self.state in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            return
        code, bit = error
        stopping = self.state in POWERED and error != OVERCURRENT and self.objects.get(0x605E)
        self._cause = cause
        self._enter(State.FAULT_REACTION_ACTIVE if stopping else State.FAULT)
        self.objects.put(0x603F, code)
        self._report(code, _GENERIC | bit)

    def lose_connection(self, code: int, register: int) -> None:
        """The master is gone: do what 0x6007 says."""
        option = self.objects.get(0x6007)
        if option == 1:
            self.fail((code, register))
            return
        self._report(code, _GENERIC | register)
        if option == 2 and self.state in POWERED:
            self._enter(State.SWITCH_ON_DISABLED)
        elif option == 3 and self.state is State.OPERATION_ENABLED:
            self._enter(State.QUICK_STOP_ACTIVE)

    def regain_connection(self) -> None:
        """The master is back: the error is over, unless it was a fault."""
        if self.state not in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            self._report(0, 0)

    def step(self, dt: float) -> None:
        """Let time pass: states, mode and motor."""
        if self.motor.temperature > HOTTEST:
            self.fail(OVERHEAT, lambda: self.motor.temperature > HOTTEST)
        if self.state is State.NOT_READY:
            self._waited += dt
            if self._waited >= START_UP:
                self._enter(State.SWITCH_ON_DISABLED)
        if self.state is State.OPERATION_ENABLED:
            self._choose_mode()
            self.mode.step(self, dt)
        elif self.state in POWERED:
            self._stop(dt)
        else:
            self.motor.rest(dt)
            self.profile = Trajectory(self.position)
        self._show()

    def _written(self, key: tuple[int, int], value: int) -> None:
        if key == (0x6040, 0):
            self._control(value)
            self._show()
        elif key == (0x6060, 0) and self.state is State.OPERATION_ENABLED:
            self._choose_mode()

    def _control(self, word: int) -> None:
        rising = word & ~self.word
        self.word = word
        if rising & _FAULT_RESET and self.state is State.FAULT and not self._cause():
            self.objects.put(0x603F, 0)
            self._report(0, 0)
            self._enter(State.SWITCH_ON_DISABLED)
            return
        asked = command(word)
        goal = TRANSITIONS.get((self.state, asked)) if asked else None
        if self.state is State.QUICK_STOP_ACTIVE and asked is Command.ENABLE_OPERATION:
            goal = goal if self.objects.get(0x605A) >= 5 else None
        if goal:
            self._enter(goal)
        if self.state is State.OPERATION_ENABLED:
            self._choose_mode()
            self.mode.control(self, rising)

    def _choose_mode(self) -> None:
        wanted = self.objects.get(0x6060)
        if self.mode.code != wanted:
            self.mode = MODES[wanted]()
            self.mode.begin(self)

    def _enter(self, state: State) -> None:
        self.state = state
        self._off_track = self._blocked = 0.0
        if state is State.OPERATION_ENABLED:
            self.profile = Trajectory(self.position, self.velocity)
            self.mode = MODES[self.objects.get(0x6060)]()
            self.mode.begin(self)

    def _stop(self, dt: float) -> None:
        """Quick stop and fault reaction."""
        option = self.objects.get(0x605A) if self.state is State.QUICK_STOP_ACTIVE else 2
        slowly = option in (1, 5)
        if option:
            self.brake(dt, deceleration=self.objects.get(0x6084 if slowly else 0x6085))
        still = not option or (self.profile.velocity == 0.0 and abs(self.motor.speed) < STILL)
        if still and self.state is State.FAULT_REACTION_ACTIVE:
            self._enter(State.FAULT)
        elif still and option < 5:
            self._enter(State.SWITCH_ON_DISABLED)

    def _show(self) -> None:
        """Write what the axis is and does into its objects."""
        objects, rated = self.objects, self.motor.data.rated_torque
        bits = self.state.value | _REMOTE | _VOLTAGE | (_WARNING if self.motor.temperature > HOT else 0)
        if self.state is State.OPERATION_ENABLED:
            bits |= self.mode.status(self)
        objects.put(0x6041, bits)
        objects.put(0x6061, objects.get(0x6060))
        objects.put(0x6062, self.profile.position)
        objects.put(0x6064, self.position)
        objects.put(0x606B, self.profile.velocity)
        objects.put(0x606C, self.velocity)
        objects.put(0x6074, 1000.0 * self.torque_demand / rated)
        objects.put(0x6077, 1000.0 * self.motor.torque / rated)
        objects.put(0x6078, 1000.0 * self.motor.torque / rated)
        objects.put(0x6079, 1000.0 * self.motor.voltage)
        objects.put(0x60F4, self.profile.position - self.position)
        objects.put(TEMPERATURE, 10.0 * self.motor.temperature)
