"""Rally points: where a vehicle that returns may go instead of home."""

from __future__ import annotations

from lfield_mavlink.plan_items import RALLY_POINT, PlanKind, coordinates, rally_points
from lfield_mavlink.services import Services


class Rally(Services):
    """The list of rally points, always as a whole."""

    async def do_set_rally_points(self, values: list[float]) -> None:
        """{latitude, longitude, height above home} for each, in place of those that were there."""
        try:
            items = rally_points(values)
        except ValueError as error:
            raise self.error(f"setRallyPoints: {error}") from None
        await self._plans.upload(PlanKind.RALLY, items)

    async def do_rally_points(self) -> list[float]:
        """Those that the vehicle holds, as setRallyPoints takes them."""
        try:
            return coordinates(await self._plans.download(PlanKind.RALLY), RALLY_POINT)
        except ValueError as error:
            raise self.error(f"rallyPoints: {error}") from None

    async def do_clear_rally_points(self) -> None:
        """Leave the vehicle without any."""
        await self._plans.clear(PlanKind.RALLY)
