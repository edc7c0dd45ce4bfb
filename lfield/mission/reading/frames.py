"""Reads where a team is: its frame's origin on the Earth, and the poses of hosts and agents in it.

```yaml
frame: {origin: {latitude: 47.3977, longitude: 8.5456, altitude: 488.0}}     # degrees, m above mean sea level
hosts:
  hall: {frame: {north: 12.0, east: 4.0, down: 0.0, heading: 0.0}}   # of all its agents: m and rad
agents:
  crane: {frame: {north: 14.0, east: 4.0}}                           # its own counts before its host's
```

All keys of an origin are needed, of a pose north and east. A vehicle with a pose is there by its own frame;
one without finds itself on the Earth, if the team has an origin. Without any of it each vehicle's places are
about its own home.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from lfield.driver.frame import Origin, Pose
from lfield.mission.bindings import FARTHEST, HIGHEST, LOWEST, Frames
from lfield.text.suggest import did_you_mean
from lfield.text.yaml_fields import Fields

_EARTHLY = ("latitude", "longitude", "altitude")


def read_origin(top: Fields) -> Origin | None:
    """The team's place on the Earth, None where it has none."""
    if "frame" not in top:
        top.node("frame")
        return None
    section = top.section("frame")
    if not section.node("origin", required=True):
        section.done()
        return None
    origin = section.section("origin")
    section.done()
    found = Origin(
        latitude=origin.number("latitude", required=True, minimum=-90.0, maximum=90.0),
        longitude=origin.number("longitude", required=True, minimum=-180.0, maximum=180.0),
        altitude=origin.number("altitude", required=True, minimum=LOWEST, maximum=HIGHEST),
    )
    origin.done()
    return found


def read_pose(fields: Fields) -> Pose | None:
    """The pose of a host or an agent, None where it has none of its own."""
    if "frame" not in fields:
        fields.node("frame")
        return None
    section = fields.section("frame")
    for key in _EARTHLY:
        if key in section:
            hint = "write north and east of the team's origin, in metres; the origin alone is in degrees"
            section.report("Y111", f"a pose takes no '{key}'", section.key_span(key), hint)
            section.node(key)
    pose = Pose(
        north=section.number("north", required=True, minimum=-FARTHEST, maximum=FARTHEST),
        east=section.number("east", required=True, minimum=-FARTHEST, maximum=FARTHEST),
        down=section.number("down", minimum=-HIGHEST, maximum=HIGHEST),
        heading=section.number("heading", minimum=-math.tau, maximum=math.tau),
    )
    section.done()
    return pose


def read_hosts(top: Fields, hosts: Collection[str] | None) -> dict[str, Pose]:
    """The poses of hosts; `hosts` are those of the team, None where it is not known."""
    found = {}
    for entry, fields in top.section("hosts").entries():
        if hosts is not None and entry.key not in hosts:
            hint = did_you_mean(entry.key, hosts) or f"its hosts: {', '.join(hosts) or 'none'}"
            fields.report("Y113", f"the deployment has no host '{entry.key}'", entry.key_span, hint)
        if (pose := read_pose(fields)) is not None:
            found[entry.key] = pose
        fields.done()
    return found


def frames_of(
    origin: Origin | None,
    hosts: Mapping[str, Pose],
    agents: Mapping[str, Pose],
    homes: Mapping[str, str],
    everybody: Collection[str],
) -> Frames:
    """Who is where: `homes` are the hosts of `everybody`, as far as they are known."""
    of_hosts = {agent: hosts[host] for agent, host in homes.items() if host in hosts}
    poses = {agent: pose for agent, pose in {**of_hosts, **agents}.items() if agent in everybody}
    return Frames(origin, dict(hosts), poses, tuple(everybody))
