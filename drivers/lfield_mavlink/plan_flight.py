"""Flies a plan of a ground station: uploads it with its fence and rally points, starts, and waits."""

from __future__ import annotations

from collections.abc import Sequence

from lfield.driver import MissionFileError, PlanRequest, PlanZone
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.files.plan_file import FIRMWARES, PlanFile
from lfield_mavlink.files.plan_report import check_plan
from lfield_mavlink.files.plan_text import read_plan_text
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.parts.fences import Fences
from lfield_mavlink.parts.missions import Missions
from lfield_mavlink.parts.motion_control import Motion
from lfield_mavlink.services.mission_commands import LANDINGS, is_flown
from lfield_mavlink.services.plan_items import RALLY_POINT, Item, PlanKind, circle, place, polygon
from lfield_mavlink.services.plan_transfer import PlanTransfer
from lfield_mavlink.setpoints.motion_orders import Command, Order

#: Seconds between two checks of a running plan, without a message.
PERIOD = 0.25
#: Seconds in which the end of a mission is reported after the motors are off.
REPORTED = 3.0
RETURN = dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH
#: The finding about a missing takeoff, which is not needed in the air.
_NEEDS_TAKEOFF = "M108"


class PlanFlight:
    """The instruction `flyPlan`. The plan is checked with the vehicle's own home, kind and firmware."""

    def __init__(
        self, vehicle: Contact, motion: Motion, missions: Missions, fences: Fences, plans: PlanTransfer
    ) -> None:
        self._vehicle, self._state, self._motion = vehicle, vehicle.state, motion
        self._missions, self._fences, self._plans = missions, fences, plans

    async def do_fly_plan(self, plan: str) -> None:
        """Flies a plan to its end. Cancelled by a hold, after which the mission stays on the vehicle."""
        try:
            file = read_plan_text(plan)
        except MissionFileError as error:
            raise self._vehicle.error(f"flyPlan: {error}") from None
        if not self._state.armed:
            raise self._vehicle.error("flyPlan refused: the vehicle is not armed; call arm() first")
        self._check(file)
        items = file.mission(px4=self._vehicle.profile.px4)
        await self._missions.upload("flyPlan", items)
        if file.fence:
            await self._fences.replace([item for zone in file.fence for item in _zone_items(zone)])
        if file.rally:
            await self._plans.upload(PlanKind.RALLY, _rally_items(file))
        await self._missions.start("flyPlan")
        await self._wait(_last_flown(items))

    def _check(self, file: PlanFile) -> None:
        """Raises DeviceError with the first finding."""
        profile, home = self._vehicle.profile, self._state.home
        if home is None or not self._state.knows_frames:
            raise self._vehicle.error("flyPlan: the home position is unknown; call waitReady()")
        firmware = next(name for name, number in FIRMWARES.items() if number == profile.autopilot)
        request = PlanRequest(
            profile.kind,
            firmware,
            self._vehicle.binding.limits,
            (home.latitude, home.longitude, home.altitude),
        )
        is_flying = profile.flies and self._state.landed is False
        errors = [
            finding
            for finding in check_plan(file, request).findings
            if finding.is_error and not (is_flying and finding.code == _NEEDS_TAKEOFF)
        ]
        if errors:
            suffix = f"; and {len(errors) - 1} more" if errors[1:] else ""
            raise self._vehicle.error(f"flyPlan refused: {file.file}: {errors[0].text}{suffix}")

    async def _wait(self, last: int) -> None:
        """Returns when the mission with this last command is complete. Raises DeviceError."""
        profile, start = self._vehicle.profile, self._vehicle.clock.monotonic()
        modes = {profile.mission, *((profile.home, profile.land) if last == RETURN else ())}
        if profile.px4:
            # The vehicle leaves the mode when the mission is complete.
            modes.add(profile.hold)
        self._motion.claim(*modes)
        flight = Order(frozenset(modes), command=Command(dialect.MAV_CMD_MISSION_START))
        # A return has no destination that a failsafe could prevent.
        end = Order(frozenset(modes))
        ends_on_ground = profile.flies and last in (RETURN, *LANDINGS)

        def is_complete() -> bool:
            return self._missions.is_complete(start)

        while not (is_complete() and not (ends_on_ground and self._state.armed)):
            self._vehicle.check_link()
            if (
                ends_on_ground
                and not self._state.armed
                and await self._vehicle.wait_for(is_complete, REPORTED)
            ):
                return
            await self._motion.check_underway("flyPlan", end if is_complete() else flight, start)
            await self._vehicle.wait_message(PERIOD)


def _last_flown(items: Sequence[Item]) -> int:
    """The command of the last item that is flown, 0 for none."""
    return next((item.command for item in reversed(items) if is_flown(item.command)), 0)


def _zone_items(zone: PlanZone) -> list[Item]:
    if len(zone.corners) == 1:
        return circle(*zone.corners[0], zone.radius, inside=zone.inclusion)
    return polygon([value for corner in zone.corners for value in corner], inside=zone.inclusion)


def _rally_items(file: PlanFile) -> list[Item]:
    frame = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    return [
        Item(RALLY_POINT, frame, *place(point.latitude, point.longitude), point.height)
        for point in file.rally
    ]
