"""Gimbal protocol v2: https://mavlink.io/en/services/gimbal_v2.html.

The gimbal manager is the autopilot, or a gimbal with a component id of its own. It obeys its primary
controller: PX4 refuses every other station, ArduPilot obeys all. So each instruction takes control unless
another station has it, or may have it: a manager that does not report it requires acquireGimbal.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Any

from lfield.driver import DeviceError
from lfield_mavlink import log_messages
from lfield_mavlink.contact.components import GIMBALS
from lfield_mavlink.contact.contact import STATE_TIMEOUT, Contact
from lfield_mavlink.geodesy import Place, Vector
from lfield_mavlink.link.dialect import AUTOPILOT, COMPONENT, dialect
from lfield_mavlink.payload.gimbal_attitude import GimbalAttitude, GimbalManager, direction
from lfield_mavlink.payload.state_reports import ATTITUDE, CONTROL, MANAGER, StateReports

#: Tolerance of an angle, and the least progress, in radians.
TOLERANCE, PROGRESS = math.radians(3.0), math.radians(1.0)
#: Seconds between two checks of the attitude, and within which PX4 reports the controller without a request.
PAUSE, BROADCAST = 0.1, 2.5
#: Values of DO_GIMBAL_MANAGER_CONFIGURE: a controller stays, or is removed if it is the sender.
UNCHANGED, REMOVED = -1.0, -3.0
NO_STATION = (0, 0)
LEVEL = dialect.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | dialect.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
YAW_LOCK = dialect.GIMBAL_MANAGER_FLAGS_YAW_LOCK

Goal = Callable[[], tuple[float, float]]


class Gimbal:
    """Instructions of the gimbal."""

    def __init__(self, vehicle: Contact, reports: StateReports) -> None:
        self._vehicle, self._reports = vehicle, reports
        self._manager: GimbalManager | None = None
        # Whether this station has primary control, as far as known.
        self._has_control = False

    # -- instructions ---------------------------------------------------------------------------------

    async def do_point_gimbal(self, pitch: float, yaw: float) -> None:
        """Points the gimbal: pitch above the horizon, yaw clockwise from the nose, with which it turns."""
        await self._point("pointGimbal", (pitch, yaw), LEVEL, lambda: (pitch, yaw))

    async def do_point_gimbal_heading(self, pitch: float, heading: float) -> None:
        """Points the gimbal to a heading clockwise from north, which it keeps when the vehicle turns."""
        goal = (pitch, math.remainder(heading, math.tau) if math.isfinite(heading) else heading)
        await self._point("pointGimbalHeading", goal, LEVEL | YAW_LOCK, lambda: self._from_nose(goal))

    async def do_point_gimbal_at(self, north: float, east: float, down: float) -> None:
        """Points the gimbal at a position relative to home, and follows that until the next instruction."""
        await self._point_at_place("pointGimbalAt", (north, east, down))

    async def do_point_gimbal_at_global(self, latitude: float, longitude: float, height: float) -> None:
        """Points the gimbal at a position in degrees, and metres above home, like `do_point_gimbal_at`."""
        instruction, state = "pointGimbalAtGlobal", self._vehicle.state
        if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):  # refuses NaN as well
            raise self._vehicle.error(
                f"{instruction} requires a latitude from -90 to 90 and a longitude from -180 to 180"
            )
        if state.home is None:
            raise self._vehicle.error(f"{instruction}: the home position is unknown")
        north, east, _ = state.home.vector_to(Place(latitude, longitude, state.home.altitude), state.radius)
        await self._point_at_place(instruction, (north, east, -height))

    async def do_acquire_gimbal(self) -> None:
        """Takes primary control, also from another station."""
        await self._control("acquireGimbal", await self._require_manager("acquireGimbal"), force=True)

    async def do_release_gimbal(self) -> None:
        """Ends following a position and gives control back."""
        instruction = "releaseGimbal"
        manager = await self._require_manager(instruction)
        holder = await self._holder(manager)
        if holder not in (NO_STATION, self._own_ids) and not (holder is None and self._has_control):
            return
        # A manager may know no regions of interest: then there is none to end.
        await self._order(
            instruction, manager, dialect.MAV_CMD_DO_SET_ROI_NONE, manager.device, optional=True
        )
        await self._configure(instruction, manager, REMOVED, REMOVED)
        self._has_control = False

    async def do_gimbal_attitude(self) -> list[float]:
        """Roll, pitch above the horizon and yaw clockwise from the nose."""
        attitude = await self._attitude(await self._require_manager("gimbalAttitude"))
        if attitude is None:
            raise self._vehicle.error("gimbalAttitude: the gimbal does not report its attitude", timeout=True)
        return [attitude.roll, attitude.pitch, attitude.yaw]

    # -- manager and control --------------------------------------------------------------------------

    async def _require_manager(self, instruction: str) -> GimbalManager:
        """The gimbal manager. Raises DeviceError without one."""
        for component in () if self._manager else (AUTOPILOT, *self._vehicle.components.present(GIMBALS)):
            message = await self._reports.request(MANAGER, component)
            if message is not None:
                self._manager = GimbalManager.from_message(message)
                break
        if self._manager is None:
            raise self._vehicle.error(
                f"{instruction} refused: no gimbal: neither the autopilot nor a component 154 or 171 to 175 "
                f"of system {self._vehicle.system} is a gimbal manager; set up the gimbal in the autopilot "
                "(ArduPilot MNT1_TYPE, PX4 MNT_MODE_IN 4 and MNT_MODE_OUT)"
            )
        return self._manager

    async def _control(self, instruction: str, manager: GimbalManager, *, force: bool = False) -> None:
        """Takes primary control; only by `force` from another station, or if the controller is unknown.

        Raises DeviceError.
        """
        holder = await self._holder(manager)
        if holder == self._own_ids or (holder is None and self._has_control):
            return
        self._vehicle.check_link()
        if holder != NO_STATION and not force:
            raise self._vehicle.error(f"{instruction} refused: {self._note_refusal(manager, holder)}")
        await self._configure(instruction, manager, float(self._vehicle.station), float(COMPONENT))
        await self._reports.confirm(
            instruction,
            CONTROL,
            lambda status: _controller(status) == self._own_ids,
            component=manager.component,
        )
        self._has_control = True

    def _note_refusal(self, manager: GimbalManager, holder: tuple[int, int] | None) -> str:
        """Logs the reason why the gimbal is not controlled, and returns it."""
        if holder is None:
            self._vehicle.note(log_messages.GIMBAL_CONTROL_UNKNOWN.line(component=manager.component))
            reason = f"component {manager.component} does not report which station controls the gimbal"
        else:
            system, component = holder
            self._vehicle.note(log_messages.GIMBAL_CONTROLLED.line(system=system, component=component))
            reason = f"system {system}, component {component} controls the gimbal"
        return f"{reason}; acquireGimbal() takes control"

    @property
    def _own_ids(self) -> tuple[int, int]:
        return self._vehicle.station, COMPONENT

    async def _holder(self, manager: GimbalManager) -> tuple[int, int] | None:
        """The system and component in primary control; None if the manager does not report it."""
        status = await self._reports.request(CONTROL, manager.component)
        if status is None and not self._has_control:

            def is_reported() -> bool:
                return self._reports.recent(CONTROL, manager.component) is not None

            await self._vehicle.wait_for(is_reported, BROADCAST)
            status = self._reports.recent(CONTROL, manager.component)
        if status is None:
            return None
        holder = _controller(status)
        self._has_control = holder == self._own_ids
        return holder

    async def _configure(
        self, instruction: str, manager: GimbalManager, system: float, component: float
    ) -> None:
        values = (system, component, UNCHANGED, UNCHANGED, None, None)
        await self._order(
            instruction, manager, dialect.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, *values, manager.device
        )

    async def _order(
        self,
        instruction: str,
        manager: GimbalManager,
        number: int,
        *values: float | None,
        optional: bool = False,
    ) -> None:
        try:
            await self._vehicle.command(
                instruction, number, *values, optional=optional, component="gimbal", target=manager.component
            )
        except DeviceError:
            self._manager = None
            raise

    # -- motion ---------------------------------------------------------------------------------------

    async def _point(self, instruction: str, goal: tuple[float, float], flags: int, expected: Goal) -> None:
        if not all(abs(angle) <= math.pi for angle in goal):
            raise self._vehicle.error(f"{instruction} requires angles from -pi to pi")
        manager = await self._require_manager(instruction)
        if reason := manager.excess_reason(*expected()):
            raise self._vehicle.error(f"{instruction} refused: {reason}")
        await self._control(instruction, manager)
        degrees = tuple(map(math.degrees, goal))
        values = (*degrees, math.nan, math.nan, float(flags), None, manager.device)
        await self._order(instruction, manager, dialect.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, *values)
        await self._reach(instruction, manager, expected)

    async def _point_at_place(self, instruction: str, goal: Vector) -> None:
        state = self._vehicle.state
        if not all(map(math.isfinite, goal)):
            raise self._vehicle.error(f"{instruction} requires a finite position")
        if state.home is None or state.position is None or not state.knows_frames:
            raise self._vehicle.error(f"{instruction}: the position of the vehicle is unknown")
        place = state.home.shifted(goal, state.radius)
        if not abs(place.latitude) <= 90.0:
            raise self._vehicle.error(f"{instruction} refused: the position is beyond a pole")
        manager = await self._require_manager(instruction)
        await self._control(instruction, manager)
        await self._vehicle.command(
            instruction, dialect.MAV_CMD_DO_SET_ROI_LOCATION, float(manager.device),
            place=place, component="gimbal", target=manager.component,
        )  # fmt: skip
        await self._reach(instruction, manager, lambda: self._from_nose(direction(self._offset(goal))))

    def _offset(self, goal: Vector) -> Vector:
        north, east, down = (
            target - position
            for target, position in zip(goal, self._vehicle.state.position or goal, strict=True)
        )
        return north, east, down

    def _from_nose(self, goal: tuple[float, float]) -> tuple[float, float]:
        """Pitch and yaw from the nose of a pitch and a heading."""
        return goal[0], math.remainder(goal[1] - (self._vehicle.state.yaw or 0.0), math.tau)

    async def _reach(self, instruction: str, manager: GimbalManager, goal: Goal) -> None:
        """Waits until the gimbal points there; a gimbal without a reported attitude has accepted the command
        only.

        A slow gimbal has time as long as it comes closer.
        """
        clock = self._vehicle.clock
        nearest, end = math.inf, clock.monotonic() + STATE_TIMEOUT
        while (attitude := await self._attitude(manager)) is not None:
            deviation = attitude.deviation(*goal())
            if deviation <= TOLERANCE:
                return
            if deviation < nearest - PROGRESS:
                nearest, end = deviation, clock.monotonic() + STATE_TIMEOUT
            if clock.monotonic() >= end:
                raise self._vehicle.error(
                    f"{instruction} was accepted but the gimbal stays {deviation:.2f} rad from there; "
                    "it may be at the end of its range, or controlled by another station"
                )
            self._vehicle.check_link()
            await asyncio.sleep(PAUSE)

    async def _attitude(self, manager: GimbalManager) -> GimbalAttitude | None:
        """The attitude of the gimbal: one that it has just sent, or on request."""
        message: Any = self._reports.recent(ATTITUDE, manager.reporter, PAUSE)
        if message is None:
            message = await self._reports.request(ATTITUDE, manager.reporter)
        return (
            None if message is None else GimbalAttitude.from_message(message, self._vehicle.state.yaw or 0.0)
        )


def _controller(status: Any) -> tuple[int, int]:
    """The system and component in primary control, of GIMBAL_MANAGER_STATUS."""
    return status.primary_control_sysid, status.primary_control_compid
