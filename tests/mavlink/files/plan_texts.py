"""Plans and waypoint files as ground stations write them, made from a few values."""

from __future__ import annotations

import json

from lfield_mavlink.geodesy import Place

HOME = Place(47.3977419, 8.545594, 488.0)
COPTER, PLANE, ROVER, VTOL = 2, 1, 10, 20
TAKEOFF, WAYPOINT, LAND, RETURN = 22, 16, 21, 20


def at(north, east):
    """Latitude and longitude in degrees, metres from home."""
    there = HOME.shifted((north, east, 0.0))
    return there.latitude, there.longitude


def simple(command, north=0.0, east=0.0, height=10.0, p=(0.0, 0.0, 0.0, None), frame=3, **more):
    """A simple item at metres from home."""
    params = [*p, *at(north, east), height]
    return {
        "type": "SimpleItem",
        "command": command,
        "frame": frame,
        "params": params,
        "autoContinue": True,
        **more,
    }


def zone(*corners, inclusion=True):
    return {"inclusion": inclusion, "polygon": [list(at(*corner)) for corner in corners], "version": 1}


def circle(radius, north=0.0, east=0.0, inclusion=True):
    return {
        "inclusion": inclusion,
        "circle": {"center": list(at(north, east)), "radius": radius},
        "version": 1,
    }


def plan(*items, firmware=3, vehicle=COPTER, polygons=(), circles=(), rally=(), **mission):
    """The bytes of a .plan."""
    tree = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2,
            "firmwareType": firmware,
            "vehicleType": vehicle,
            "cruiseSpeed": 15,
            "hoverSpeed": 5,
            "plannedHomePosition": [HOME.latitude, HOME.longitude, HOME.altitude],
            "items": list(items),
            **mission,
        },
        "geoFence": {"version": 2, "circles": list(circles), "polygons": list(polygons)},
        "rallyPoints": {"version": 2, "points": [[*at(*place[:2]), place[2]] for place in rally]},
    }
    return json.dumps(tree).encode()


def survey(*items, **more):
    return {
        "type": "ComplexItem",
        "complexItemType": "survey",
        "version": 5,
        "polygon": [list(at(0, 0)), list(at(50, 0)), list(at(50, 50))],
        "TransectStyleComplexItem": {"version": 1, "Items": list(items), **more},
    }


def landing(kind="fwLandingPattern", **more):
    return {
        "type": "ComplexItem",
        "complexItemType": kind,
        "version": 2,
        "altitudesAreRelative": True,
        "landingApproachCoordinate": [*at(100, 0), 40.0],
        "landCoordinate": [*at(0, 0), 0.0],
        "loiterRadius": 30.0,
        "loiterClockwise": False,
        "valueSetIsDistance": True,
        **more,
    }


def rows(*items, home=HOME, version=110, newline="\n"):
    """The bytes of a QGC WPL file; an item is (frame, command, p1 to p4, north, east, height)."""
    lines = [f"QGC WPL {version}"]
    if home is not None:
        lines.append(
            f"0\t1\t0\t16\t0\t0\t0\t0\t{home.latitude:.8f}\t{home.longitude:.8f}\t{home.altitude}\t1"
        )
    for number, (frame, command, *rest) in enumerate(items, len(lines) - 1):
        *p, north, east, height = rest
        place = "\t".join(f"{value:.8f}" for value in at(north, east))
        lines.append(
            f"{number}\t0\t{frame}\t{command}\t" + "\t".join(map(str, p)) + f"\t{place}\t{height}\t1"
        )
    return newline.join([*lines, ""]).encode()
