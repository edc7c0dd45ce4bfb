"""Whether a vehicle may be armed, the reasons against it, and the autopilot's knowledge in a cold start.

`Pilot.warm_up` is the duration of the start in seconds; 0 for a vehicle that is warm. The order of events is
data (`flavours.StartupTiming`), from the traces `a-cold-start` of the three.
"""

from __future__ import annotations

from msgspec import Struct

from lfield_sim.autopilot.flavours import Role
from lfield_sim.autopilot.pilot import Pilot

#: Seconds between two warnings that the vehicle cannot be armed.
WARNED = 30.0


class ArmingRefusal(Struct, frozen=True):
    """A refusal to arm a vehicle.

    `reasons` are sent in one text each; None is a refusal without a text.
    """

    reasons: tuple[str, ...] | None


def startup_progress(pilot: Pilot) -> float:
    """The progress of the start, 0 to 1."""
    return 1.0 if pilot.warm_up <= 0.0 else min(1.0, pilot.uptime / pilot.warm_up)


def has_fix(pilot: Pilot) -> bool:
    """Whether GNSS has a fix."""
    return not pilot.gps_lost and startup_progress(pilot) >= pilot.kind.warming.fix


def has_home(pilot: Pilot) -> bool:
    """Whether home is known."""
    return startup_progress(pilot) >= pilot.kind.warming.home


def has_origin(pilot: Pilot) -> bool:
    """Whether the origin of the local frame is known."""
    return startup_progress(pilot) >= pilot.kind.warming.origin


def has_position(pilot: Pilot) -> bool:
    """Whether the autopilot reports its local position."""
    found = not pilot.gps_lost or pilot.armed or pilot.vehicle.airborne
    return found and startup_progress(pilot) >= pilot.kind.warming.position


def new_texts(pilot: Pilot, dt: float) -> list[str]:
    """The texts of the last `dt` seconds: about the start, and the reasons against arming."""
    found: list[str] = []
    if 0.0 < pilot.uptime - dt < pilot.warm_up:
        before = (pilot.uptime - dt) / pilot.warm_up
        texts = pilot.kind.warming.texts
        found += [
            text for at, group in texts if before < at <= pilot.uptime / pilot.warm_up for text in group
        ]
    if pilot.flavour.warning and not pilot.armed and pilot.uptime % WARNED < dt < pilot.uptime:
        unfit = arming_refusal(pilot)
        reasons = unfit.reasons if unfit is not None else None
        found += [pilot.flavour.warning.format(reason=reason) for reason in reasons or ()]
    return found


def trusts_position(pilot: Pilot) -> bool:
    """Whether the estimator trusts the position."""
    blind = pilot.estimate.blind > 0.85 * pilot.flavour.blind.lasts
    return has_position(pilot) and not blind and startup_progress(pilot) >= pilot.kind.warming.estimate


def arming_refusal(pilot: Pilot) -> ArmingRefusal | None:
    """The reason why the vehicle cannot be armed now, None when it can."""
    if reason := pilot.refuse_arming or pilot.ailing:
        return ArmingRefusal((reason,))
    if pilot.gps_lost:
        fence = pilot.flavour.fence
        fenced = fence.blind_text and pilot.parameters[fence.enable]
        return ArmingRefusal((fence.blind_text if fenced else "Need Position Estimate",))
    done = startup_progress(pilot)
    by_hand = pilot.role is Role.MANUAL and done >= pilot.kind.warming.by_hand
    if by_hand and not has_position(pilot) and pilot.value(pilot.flavour.fence.enable):
        return ArmingRefusal((pilot.flavour.fence.blind_text,))
    if done >= 1.0 or by_hand:
        return None
    return ArmingRefusal(next(texts for until, texts in pilot.kind.warming.reasons if done < until))
