"""Parameters of the autopilot, for programs."""

from __future__ import annotations

from lfield_mavlink.services import Services
from lfield_mavlink.watchdog import SETTINGS

#: What the driver sets at opening, since it protects the vehicle when this computer is gone.
PROTECTED = frozenset(name for settings in SETTINGS.values() for one in settings for name in one.names)


class Settings(Services):
    """Reading and writing parameters by their names."""

    async def do_parameter(self, name: str) -> float:
        """The value of a parameter, whole numbers included."""
        value = await self._parameters.read(name)
        if value is None:
            raise self._parameters.unknown(name)
        return float(value)

    async def do_set_parameter(self, name: str, value: float) -> None:
        """Set a parameter; done when the autopilot has told the new value."""
        if name in PROTECTED:
            raise self.error(
                f"setParameter refused: {name} stops the vehicle when this computer is gone, "
                "and is set from the binding"
            )
        await self._parameters.write(name, value)

    async def do_parameters(self) -> str:
        """All of them, sorted, one per line: `NAME VALUE`."""
        found = await self._parameters.read_all()
        return "\n".join(f"{name} {value:.9g}" for name, value in sorted(found.items()))
