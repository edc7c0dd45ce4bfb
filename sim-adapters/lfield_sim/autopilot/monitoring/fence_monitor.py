"""The fences of one autopilot: goals that it refuses, and its actions outside.

From the traces `f-fence-landing` and `f-fence-breach`: ArduCopter ignores a goal beyond its fence and stops a
velocity inside (AVOID_ENABLE), ArduRover drives to the edge; both breach only if avoidance is off. PX4 flies
through, and detects it. The fence acts once for each breach.
"""

from __future__ import annotations

from lfield_sim.autopilot.body.goals import Reach, Vector
from lfield_sim.autopilot.flavours import Role
from lfield_sim.autopilot.pilot import Pilot
from lfield_sim.autopilot.plans import NO_BREACH
from lfield_sim.autopilot.vehicle import VelocityFence

#: Seconds from crossing the edge until it is detected, and from then until the action.
NOTICED, ACTED = 0.1, 0.04
#: Seconds after which PX4 reports a breach again when it holds before it acts.
AGAIN = 2.06


class FenceMonitor:
    """Monitors the fences while the vehicle is armed."""

    def __init__(self, pilot: Pilot) -> None:
        self._pilot = pilot
        self._rule = pilot.flavour.fence
        self._since: float | None = None
        self._acts_at: float | None = None
        self._repeat_at: float | None = None
        self.breach = NO_BREACH
        self.breaches = 0
        self.breached_at = 0.0

    def accepts(self, place: Vector) -> bool:
        """Whether the autopilot accepts a goal; PX4 sends a text when it does not."""
        is_outside = self._pilot.fence_at(place)[0] != NO_BREACH
        if is_outside and self._rule.outside_text:
            self._pilot.say(self._rule.outside_text)
        return not (is_outside and self._rule.refuses)

    def commanded(self) -> None:
        """Sends a text about a command that was given outside the fence."""
        if self.breach and self._rule.recovery_text:
            self._pilot.say(self._rule.recovery_text)

    def check(self) -> Role | None:
        """Checks once; returns the role for a breach that is due now."""
        self._limit_velocity()
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
            self._on_breach(breach)
        if self._acts_at is None or pilot.now < self._acts_at:
            self._repeat_text(text)
            return None
        self._acts_at = None
        role = self._rule.actions.get(int(pilot.value(self._rule.action)))
        self._say(text, repeats=bool(self._rule.hold_text) and role is not Role.HOLD)
        if self._rule.recovery_text:
            pilot.say(self._rule.recovery_text)
        return role

    def _on_breach(self, breach: int) -> None:
        self.breach, self.breached_at = breach, self._pilot.now
        self.breaches = min(self.breaches + 1, 0xFFFF)
        self._acts_at = self._pilot.now + ACTED

    def _repeat_text(self, text: str) -> None:
        """Repeats PX4's text."""
        if self._repeat_at is not None and self._pilot.now >= self._repeat_at:
            self._repeat_at = None
            self._pilot.say(text)

    def _say(self, text: str, *, repeats: bool) -> None:
        self._repeat_at = self._pilot.now + AGAIN if repeats else None
        if text:
            self._pilot.say(text)

    def _limit_velocity(self) -> None:
        """Keeps the vehicle inside the circle if avoidance is active."""
        pilot, rule = self._pilot, self._rule
        radius = pilot.value(rule.radius) if pilot.value(rule.enable) else 0.0
        # A copter ignores a goal beyond, but follows a velocity there; a rover follows both.
        may_leave = not (pilot.flies and isinstance(pilot.vehicle.goal, Reach))
        avoids = bool(rule.avoid) and pilot.value(rule.avoid) > 0.0 and radius > 0.0
        if not (avoids and may_leave and pilot.role is Role.GUIDED):
            pilot.vehicle.velocity_fence = None
            return
        max_radius = max(0.0, radius - pilot.value(rule.margin))
        pilot.vehicle.velocity_fence = VelocityFence(pilot.home[0], pilot.home[1], max_radius)
