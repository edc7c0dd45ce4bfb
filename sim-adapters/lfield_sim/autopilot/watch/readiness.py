"""Whether a vehicle may be armed, why not, and what it knows meanwhile: a start takes its time.

`Pilot.warm_up` is how long the start takes, in seconds; 0 is a vehicle that was switched on long ago. What
comes when is data (`flavours.Warming`), by the traces `a-cold-start` of the three.
"""

from __future__ import annotations

from dataclasses import dataclass

from lfield_sim.autopilot.flavours import Role
from lfield_sim.autopilot.pilot import Pilot

#: Seconds between two warnings that it cannot be armed.
WARNED = 30.0


@dataclass(frozen=True, slots=True)
class Unfit:
    """Why a vehicle cannot be armed.

    reasons   those that it tells, each in a text of its own; None when it says not a word
    """

    reasons: tuple[str, ...] | None


def warmth(pilot: Pilot) -> float:
    """How far its start has come, from 0 to 1."""
    return 1.0 if pilot.warm_up <= 0.0 else min(1.0, pilot.uptime / pilot.warm_up)


def has_fix(pilot: Pilot) -> bool:
    """Whether GPS tells where it is."""
    return not pilot.gps_lost and warmth(pilot) >= pilot.kind.warming.fix


def has_home(pilot: Pilot) -> bool:
    """Whether it knows home."""
    return warmth(pilot) >= pilot.kind.warming.home


def has_origin(pilot: Pilot) -> bool:
    """Whether it knows the origin of its frame."""
    return warmth(pilot) >= pilot.kind.warming.origin


def has_position(pilot: Pilot) -> bool:
    """Whether it tells where it is in its frame."""
    found = not pilot.gps_lost or pilot.armed or pilot.vehicle.airborne
    return found and warmth(pilot) >= pilot.kind.warming.position


def news(pilot: Pilot, dt: float) -> list[str]:
    """What it says of itself in the last `dt` seconds: of its start, and why it cannot be armed."""
    found: list[str] = []
    if 0.0 < pilot.uptime - dt < pilot.warm_up:
        before = (pilot.uptime - dt) / pilot.warm_up
        texts = pilot.kind.warming.texts
        found += [text for at, told in texts if before < at <= pilot.uptime / pilot.warm_up for text in told]
    if pilot.flavour.warning and not pilot.armed and pilot.uptime % WARNED < dt < pilot.uptime:
        unfit = why_unfit(pilot)
        reasons = unfit.reasons if unfit is not None else None
        found += [pilot.flavour.warning.format(reason=reason) for reason in reasons or ()]
    return found


def trusts_position(pilot: Pilot) -> bool:
    """Whether its estimator says that it knows the position."""
    blind = pilot.estimate.blind > 0.85 * pilot.flavour.blind.lasts
    return has_position(pilot) and not blind and warmth(pilot) >= pilot.kind.warming.estimate


def why_unfit(pilot: Pilot) -> Unfit | None:
    """Why it cannot be armed now, None when it can."""
    if reason := pilot.refuse_arming or pilot.ailing:
        return Unfit((reason,))
    if pilot.gps_lost:
        fence = pilot.flavour.fence
        fenced = fence.blind_text and pilot.parameters[fence.enable]
        return Unfit((fence.blind_text if fenced else "Need Position Estimate",))
    done = warmth(pilot)
    by_hand = pilot.role is Role.MANUAL and done >= pilot.kind.warming.by_hand
    if by_hand and not has_position(pilot) and pilot.value(pilot.flavour.fence.enable):
        return Unfit((pilot.flavour.fence.blind_text,))
    if done >= 1.0 or by_hand:
        return None
    return Unfit(next(texts for until, texts in pilot.kind.warming.reasons if done < until))
