"""One axis of a CiA 402 drive: its states, modes and faults (CiA 402-2). Pure; stepped by time."""

from __future__ import annotations

from collections.abc import Callable

from lfield_sim.can.can_motor import CanMotor
from lfield_sim.can.canopen.sdo import ObjectDictionary
from lfield_sim.can.cia402.cia402_drive import Cia402Drive, DriveError
from lfield_sim.can.cia402.cia402_table import (
    END_OPTIONS,
    POWERED,
    TEMPERATURE,
    TRANSITIONS,
    DriveCommand,
    DriveState,
    command_of,
)
from lfield_sim.can.cia402.operation_modes import MODES, OperationMode

#: Seconds from power-up to SWITCH ON DISABLED.
START_UP = 0.05
#: rad/s below which a motor is at rest.
STILL = 0.05
HOT, HOTTEST = 80.0, 100.0
OVERCURRENT, OVERHEAT = (0x2310, 0x02), (0x4310, 0x08)
_GENERIC = 0x01
_FAULT_RESET = 0x80
_VOLTAGE, _WARNING, _REMOTE = 0x10, 0x80, 0x200


class Cia402Axis:
    """One axis; `report(code, register)` sends an emergency."""

    def __init__(
        self, objects: ObjectDictionary, motor: CanMotor, report: Callable[[int, int], None]
    ) -> None:
        self.objects, self.motor, self._report = objects, motor, report
        self.drive = Cia402Drive(objects, motor, self.fail)
        objects.watch(self._written)
        self.reset()

    def reset(self) -> None:
        """Sets the power-up state."""
        self.state = DriveState.NOT_READY
        self.drive.reset()
        self.mode: OperationMode = MODES[0]()
        #: The state after the ramp at the end of operation.
        self._leaving: DriveState | None = None
        self._waited = 0.0
        self._cause: Callable[[], bool] = lambda: False

    def fail(self, error: DriveError, cause: Callable[[], bool] = lambda: False) -> None:
        """Enters FAULT, after stopping if the power stage still can; `cause` returns whether it lasts."""
        if self.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            return
        code, bit = error
        stopping = self.state in POWERED and error != OVERCURRENT and self.objects.get(0x605E)
        self._cause = cause
        self._enter(DriveState.FAULT_REACTION_ACTIVE if stopping else DriveState.FAULT)
        self.objects.put(0x603F, code)
        self._report(code, _GENERIC | bit)

    def lose_connection(self, code: int, register: int) -> None:
        """Handles the loss of the master by the option in 0x6007."""
        option = self.objects.get(0x6007)
        if option == 1:
            self.fail((code, register))
            return
        self._report(code, _GENERIC | register)
        command = {2: DriveCommand.DISABLE_VOLTAGE, 3: DriveCommand.QUICK_STOP}.get(option)
        if command and (goal := TRANSITIONS.get((self.state, command))):
            self._enter(goal)

    def regain_connection(self) -> None:
        """Ends the error of a lost master, unless it was a fault."""
        if self.state not in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            self._report(0, 0)

    def step(self, dt: float) -> None:
        """Advances time: states, mode and motor."""
        if self.motor.temperature > HOTTEST:
            self.fail(OVERHEAT, lambda: self.motor.temperature > HOTTEST)
        if self.state is DriveState.NOT_READY:
            self._waited += dt
            if self._waited >= START_UP:
                self._enter(DriveState.SWITCH_ON_DISABLED)
        if self.state is DriveState.OPERATION_ENABLED and not self._leaving:
            self._choose_mode()
            self.mode.step(self.drive, dt)
        elif self.state in POWERED:
            self._stop(dt)
        else:
            self.drive.step_unpowered(dt)
        self._publish()

    def _written(self, key: tuple[int, int], value: int) -> None:
        if key == (0x6040, 0):
            self._control(value)
            self._publish()
        elif key == (0x6060, 0) and self.state is DriveState.OPERATION_ENABLED:
            self._choose_mode()

    def _control(self, controlword: int) -> None:
        rising = controlword & ~self.drive.controlword
        self.drive.controlword = controlword
        if rising & _FAULT_RESET and self.state is DriveState.FAULT and not self._cause():
            self.objects.put(0x603F, 0)
            self._report(0, 0)
            self._enter(DriveState.SWITCH_ON_DISABLED)
            return
        command = command_of(controlword)
        goal = TRANSITIONS.get((self.state, command)) if command else None
        if self.state is DriveState.QUICK_STOP_ACTIVE and command is DriveCommand.ENABLE_OPERATION:
            goal = goal if self.objects.get(0x605A) >= 5 else None
        if self._leaving and command is DriveCommand.ENABLE_OPERATION:
            goal = DriveState.OPERATION_ENABLED
        if goal:
            self._go(goal)
        if self.state is DriveState.OPERATION_ENABLED and not self._leaving:
            self._choose_mode()
            self.mode.control(self.drive, rising)

    def _go(self, goal: DriveState) -> None:
        """Makes a commanded transition; one that ends operation may ramp down first."""
        option = END_OPTIONS.get(goal) if self.state is DriveState.OPERATION_ENABLED else None
        if option and self.objects.get(option):
            self._leaving = goal
        else:
            self._enter(goal)

    def _choose_mode(self) -> None:
        requested = self.objects.get(0x6060)
        if self.mode.code != requested:
            self.mode = MODES[requested]()
            self.mode.start(self.drive)

    def _enter(self, state: DriveState) -> None:
        self.state, self._leaving = state, None
        self.drive.reset_monitoring()
        if state is DriveState.OPERATION_ENABLED:
            self.drive.take_over()
            self.mode = MODES[self.objects.get(0x6060)]()
            self.mode.start(self.drive)

    def _stop(self, dt: float) -> None:
        """Runs a quick stop, fault reaction, or the ramp at the end of operation; 0 lets the motor coast."""
        codes = {DriveState.QUICK_STOP_ACTIVE: 0x605A, DriveState.FAULT_REACTION_ACTIVE: 0x605E}
        option = self.objects.get(codes[self.state]) if self.state in codes else 1
        if option:
            self.drive.stop(dt, option)
        else:
            self.drive.step_unpowered(dt)
        if option and (self.drive.profile.velocity != 0.0 or abs(self.motor.speed) >= STILL):
            return
        if self.state is DriveState.FAULT_REACTION_ACTIVE:
            self._enter(DriveState.FAULT)
        elif self._leaving:
            self._enter(self._leaving)
        elif option < 5:
            self._enter(DriveState.SWITCH_ON_DISABLED)

    def _publish(self) -> None:
        """Writes the axis's state into its objects."""
        objects, drive, rated = self.objects, self.drive, self.motor.data.rated_torque
        bits = self.state.value | _REMOTE | _VOLTAGE | (_WARNING if self.motor.temperature > HOT else 0)
        if self.state is DriveState.OPERATION_ENABLED:
            bits |= self.mode.status(self.drive)
        objects.put(0x6041, bits)
        objects.put(0x6061, objects.get(0x6060))
        objects.put(0x6062, drive.profile.position)
        objects.put(0x6064, drive.position)
        objects.put(0x606B, drive.profile.velocity)
        objects.put(0x606C, drive.velocity)
        objects.put(0x6074, 1000.0 * drive.torque_demand / rated)
        objects.put(0x6077, 1000.0 * self.motor.torque / rated)
        objects.put(0x6078, 1000.0 * self.motor.torque / rated)
        objects.put(0x6079, 1000.0 * self.motor.voltage)
        objects.put(0x60F4, drive.profile.position - drive.position)
        objects.put(TEMPERATURE, 10.0 * self.motor.temperature)
