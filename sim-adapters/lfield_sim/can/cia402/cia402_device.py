"""A CiA 402 drive on the bus: a CANopen node with one axis. Pure; stepped by time."""

from __future__ import annotations

from lfield_sim.can.can_bus import CanFrame, FaultLookup
from lfield_sim.can.can_motor import CanMotor, CanMotorData
from lfield_sim.can.canopen.canopen_node import COMMUNICATION, HEARTBEAT_LOST, CanopenNode
from lfield_sim.can.canopen.sdo import ObjectDictionary
from lfield_sim.can.cia402.cia402_axis import OVERCURRENT, STILL, Cia402Axis
from lfield_sim.can.cia402.cia402_drive import FOLLOWING
from lfield_sim.can.cia402.cia402_table import INCREMENTS, entries
from lfield_sim.state_log import Facts


class Cia402Device:
    """The drive with a node id from 1 to 127 (see `bus_world.BusDevice`).

    `increments` are per turn of its encoder; `data` is its motor, with the ratings (0x6075, 0x6076) that it
    reports.
    """

    def __init__(
        self, node: int, flaw: FaultLookup, data: CanMotorData | None = None, increments: int = INCREMENTS
    ) -> None:
        data = data or CanMotorData()
        self.motor, self._flaw = CanMotor(data), flaw
        rated_current = data.rated_torque / data.torque_constant
        objects = ObjectDictionary(entries(node, increments, data.rated_torque, rated_current))
        self.node = CanopenNode(node, objects, flaw)
        self.axis = Cia402Axis(objects, self.motor, self.node.emergency)
        self.node.on_reset = self.axis.reset
        self.node.on_heartbeat_lost = lambda: self.axis.lose_connection(HEARTBEAT_LOST, COMMUNICATION)
        self.node.on_heartbeat_back = self.axis.regain_connection

    @property
    def id(self) -> str:
        """The node id."""
        return str(self.node.node)

    def power_up(self) -> list[CanFrame]:
        """Restarts; returns the boot-up message."""
        return self.node.boot()

    def power_down(self) -> None:
        """Stops driving the motor."""
        self.axis.reset()

    def on_frame(self, frame: CanFrame) -> list[CanFrame]:
        """Receives a frame; returns the answers."""
        return self.node.on_frame(frame)

    def step(self, dt: float) -> list[CanFrame]:
        """Advances time; returns the frames that the drive sends."""
        self.motor.stuck = bool(self._flaw("stuck"))
        self.motor.overheated = bool(self._flaw("overheat"))
        if self._flaw("overcurrent"):
            self.axis.fail(OVERCURRENT, lambda: bool(self._flaw("overcurrent")))
        if self._flaw("follow_error"):
            self.axis.fail(FOLLOWING, lambda: bool(self._flaw("follow_error")))
        self.axis.step(dt)
        return self.node.step(dt)

    def facts(self) -> Facts:
        """The state of the drive, and `master_lost`: whether the monitored heartbeat (0x1016) is lost."""
        moving = abs(self.motor.speed) > STILL
        return {"state": self.axis.state.name, "moving": moving, "master_lost": self.node.master_lost}
