"""Reads the team's frame: its origin on the Earth, and the poses of hosts and agents in it.

```yaml
frame: {origin: {latitude: 47.3977, longitude: 8.5456, altitude: 488.0}}     # degrees, m above mean sea level
hosts:
  hall: {frame: {north: 12.0, east: 4.0, down: 0.0, heading: 0.0}}   # of all its agents: m and rad
agents:
  crane: {frame: {north: 14.0, east: 4.0}}                           # takes precedence over that of its host
```

An origin needs all keys, a pose north and east. A vehicle with a pose reports positions relative to its own
local frame; a vehicle without one uses its global position, if the team has an origin. Without a frame the
positions of each vehicle are relative to its own home.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from lfield.driver.frame import Origin, Pose
from lfield.mission.bindings import MAX_ALTITUDE, MAX_DISTANCE, MIN_ALTITUDE, Frames
from lfield.text.suggestions import did_you_mean
from lfield.text.yaml_fields import YamlFields

_EARTHLY = ("latitude", "longitude", "altitude")


def read_origin(top: YamlFields) -> Origin | None:
    """The origin of the team's frame on the Earth, None without one."""
    if "frame" not in top:
        top.node("frame")
        return None
    section = top.section("frame")
    if not section.node("origin", required=True):
        section.report_unread()
        return None
    origin = section.section("origin")
    section.report_unread()
    found = Origin(
        latitude=origin.number("latitude", required=True, minimum=-90.0, maximum=90.0),
        longitude=origin.number("longitude", required=True, minimum=-180.0, maximum=180.0),
        altitude=origin.number("altitude", required=True, minimum=MIN_ALTITUDE, maximum=MAX_ALTITUDE),
    )
    origin.report_unread()
    return found


def read_pose(fields: YamlFields) -> Pose | None:
    """The pose of a host or agent, None without one of its own."""
    if "frame" not in fields:
        fields.node("frame")
        return None
    section = fields.section("frame")
    for key in _EARTHLY:
        if key in section:
            hint = "write north and east of the team's origin, in metres; the origin alone is in degrees"
            section.report("Y111", f"a pose has no key '{key}'", section.key_span(key), hint)
            section.node(key)
    pose = Pose(
        north=section.number("north", required=True, minimum=-MAX_DISTANCE, maximum=MAX_DISTANCE),
        east=section.number("east", required=True, minimum=-MAX_DISTANCE, maximum=MAX_DISTANCE),
        down=section.number("down", minimum=-MAX_ALTITUDE, maximum=MAX_ALTITUDE),
        heading=section.number("heading", minimum=-math.tau, maximum=math.tau),
    )
    section.report_unread()
    return pose


def read_hosts(top: YamlFields, hosts: Collection[str] | None) -> dict[str, Pose]:
    """The poses of hosts; `hosts` are those of the team, None where it is unknown."""
    poses = {}
    for entry, fields in top.section("hosts").entries():
        if hosts is not None and entry.key not in hosts:
            hint = did_you_mean(entry.key, hosts) or f"its hosts: {', '.join(hosts) or 'none'}"
            fields.report("Y113", f"the deployment has no host '{entry.key}'", entry.key_span, hint)
        if (pose := read_pose(fields)) is not None:
            poses[entry.key] = pose
        fields.report_unread()
    return poses


def frames_of(
    origin: Origin | None,
    hosts: Mapping[str, Pose],
    agents: Mapping[str, Pose],
    homes: Mapping[str, str],
    everybody: Collection[str],
) -> Frames:
    """The frames of the team; `homes` are the known hosts of `everybody`."""
    of_hosts = {agent: hosts[host] for agent, host in homes.items() if host in hosts}
    poses = {agent: pose for agent, pose in {**of_hosts, **agents}.items() if agent in everybody}
    return Frames(origin, dict(hosts), poses, tuple(everybody))
