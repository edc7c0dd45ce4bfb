"""The services that every vehicle of the fake has, in one list."""

from __future__ import annotations

from lfield_sim.mavlink.files import Files
from lfield_sim.mavlink.parameters import Parameters
from lfield_sim.mavlink.plans import Plans
from lfield_sim.mavlink.service import Service

#: Their classes; made anew for every vehicle as `kind(autopilot, place)`.
SERVICES: tuple[type[Service], ...] = (Parameters, Plans, Files)
