"""The fences of one autopilot: where it will not go, and what becomes of it when it is outside all the same.

By the traces `f-fence-landing` and `f-fence-breach`: ArduCopter ignores a goal beyond its fence and stops a
velocity inside (AVOID_ENABLE), ArduRover drives to the edge; both breach only where avoiding is off. PX4
flies through, and notices. The fence acts once for each breach.
"""

from __future__ import annotations

from lfield_sim.autopilot.body.goals import Reach, Vector
from lfield_sim.autopilot.flavours import Role
from lfield_sim.autopilot.pilot import Pilot
from lfield_sim.autopilot.plans import NO_BREACH
from lfield_sim.autopilot.vehicle import Corral

#: Seconds from crossing the edge until it is noticed, and from then until something is done about it.
NOTICED, ACTED = 0.1, 0.04
#: Seconds after which PX4 tells a breach once more, when it holds before it acts.
AGAIN = 2.06


class Fences:
    """The watcher of the fences; it looks while the vehicle is armed."""

    def __init__(self, pilot: Pilot) -> None:
        self._pilot = pilot
        self._rule = pilot.flavour.fence
        self._since: float | None = None
        self._acts_at: float | None = None
        self._says_at: float | None = None
        self.breach = NO_BREACH
        self.breaches = 0
        self.breached_at = 0.0

    def takes(self, place: Vector) -> bool:
        """Whether a goal is one that it goes to; PX4 says it when it is not."""
        beyond = self._pilot.fence_at(place)[0] != NO_BREACH
        if beyond and self._rule.outside_text:
            self._pilot.say(self._rule.outside_text)
        return not (beyond and self._rule.refuses)

    def commanded(self) -> None:
        """Somebody took over: outside the fence this is said."""
        if self.breach and self._rule.recovery_text:
            self._pilot.say(self._rule.recovery_text)

    def check(self) -> Role | None:
        """Look once; the role that the vehicle is to take for a breach, now."""
        self._corral()
        pilot = self._pilot
        breach, text = pilot.fence_at(pilot.vehicle.place) if pilot.armed else (NO_BREACH, "")
        if not breach:
            if self.breach and self._rule.cleared_text and pilot.armed:
                pilot.say(self._rule.cleared_text)
            self.breach, self._since, self._acts_at = NO_BREACH, None, None
            return None
        if self._since is None:
            self._since = pilot.now
        if breach != self.breach and pilot.now - self._since >= NOTICED:
            self._begin(breach)
        if self._acts_at is None or pilot.now < self._acts_at:
            self._say_again(text)
            return None
        self._acts_at = None
        role = self._rule.actions.get(int(pilot.value(self._rule.action)))
        self._say(text, again=bool(self._rule.hold_text) and role is not Role.HOLD)
        if self._rule.recovery_text:
            pilot.say(self._rule.recovery_text)
        return role

    def _begin(self, breach: int) -> None:
        self.breach, self.breached_at = breach, self._pilot.now
        self.breaches = min(self.breaches + 1, 0xFFFF)
        self._acts_at = self._pilot.now + ACTED

    def _say_again(self, text: str) -> None:
        """PX4 says it once more."""
        if self._says_at is not None and self._pilot.now >= self._says_at:
            self._says_at = None
            self._pilot.say(text)

    def _say(self, text: str, *, again: bool) -> None:
        self._says_at = self._pilot.now + AGAIN if again else None
        if text:
            self._pilot.say(text)

    def _corral(self) -> None:
        """Keep it inside the circle where that is what it avoids by."""
        pilot, rule = self._pilot, self._rule
        radius = pilot.value(rule.radius) if pilot.value(rule.enable) else 0.0
        # A copter does not set out for a place beyond, but a velocity leads there; a rover does both.
        led = not (pilot.flies and isinstance(pilot.vehicle.goal, Reach))
        avoids = bool(rule.avoid) and pilot.value(rule.avoid) > 0.0 and radius > 0.0
        if not (avoids and led and pilot.role is Role.GUIDED):
            pilot.vehicle.corral = None
            return
        inside = max(0.0, radius - pilot.value(rule.margin))
        pilot.vehicle.corral = Corral(pilot.home[0], pilot.home[1], inside)
