"""The frame of a team: origins and poses in a devices file, their errors and effects."""

from __future__ import annotations

import pytest

from lfield.driver.binding import SIMULATED
from lfield.driver.frame import Origin, Placement, Pose
from lfield.driver.plugins import Plugins
from lfield.errors import BindingError, BundleError
from lfield.mission import bundle
from lfield.mission.bindings import Frames
from lfield.mission.bindings_file import read_bindings, read_frames
from lfield.mission.loader import load_mission, rebound

NEEDED = {"alpha": {"fc": "Mavlink"}, "beta": {"fc": "Mavlink"}, "crane": {}}
HOMES = {"alpha": "air", "beta": "ground", "crane": "ground"}
ORIGIN = "frame: {origin: {latitude: 47.4, longitude: 8.5, altitude: 488}}\n"
DEVICES = """\
agents:
  alpha: {frame: {north: 3, east: -4.5, heading: 0.5}, devices: {fc: {driver: mavlink, endpoint: "udp:h:1"}}}
  beta: {devices: {fc: {driver: mavlink, endpoint: "udp:h:2"}}}
"""
HOSTS = "hosts: {ground: {frame: {north: 10, east: 20, down: -1}}}\n"


@pytest.fixture(scope="module")
def plugins() -> Plugins:
    plugins = Plugins()
    plugins.add("lfield_mavlink:PLUGIN")
    return plugins


@pytest.fixture
def reading(tmp_path, plugins):
    def read(text, **options):
        path = tmp_path / "m.devices.yaml"
        path.write_text(text, encoding="utf-8")
        return read_bindings(path, NEEDED, plugins, hosts=("air", "ground"), homes=HOMES, **options)

    return read


@pytest.fixture
def wrong(reading):
    def problems(text, **options):
        with pytest.raises(BindingError) as error:
            reading(text, **options)
        return "\n".join(error.value.problems)

    return problems


def test_the_pose_of_an_agent_overrides_its_hosts_and_both_override_the_origin(reading):
    bound = reading(ORIGIN + HOSTS + DEVICES)
    origin = Origin(47.4, 8.5, 488.0)
    own, hosts = Pose(3.0, -4.5, 0.0, 0.5), Pose(10.0, 20.0, -1.0)
    assert bound.frames == Frames(
        origin, {"ground": hosts}, {"alpha": own, "beta": hosts, "crane": hosts}, ("alpha", "beta", "crane")
    )
    assert bound.devices["alpha"]["fc"].frame == Placement(origin, own, 0)
    assert bound.devices["beta"]["fc"].frame == Placement(origin, hosts, 1)


def test_an_agent_without_a_pose_is_at_its_position_on_the_earth(reading):
    bound = reading(ORIGIN + DEVICES)
    assert bound.devices["beta"]["fc"].frame == Placement(Origin(47.4, 8.5, 488.0), None, 1)


def test_without_a_frame_no_device_has_one(reading):
    bound = reading(DEVICES.replace("frame: {north: 3, east: -4.5, heading: 0.5}, ", ""))
    assert not bound.frames
    assert [device.frame for device in bound.all] == [None, None]


def test_a_vehicle_without_a_place_in_the_teams_frame_is_refused(reading, wrong):
    finding = wrong(DEVICES)
    assert (
        "beta.fc (Mavlink) reports positions, but their place in the team's frame is unknown: give beta or"
        in finding
    )
    assert "or give the team an origin" in finding
    assert "alpha" not in finding
    unbound = DEVICES.partition("  beta:")[0]
    assert "beta.fc (Mavlink) reports positions" in wrong(unbound, simulate=True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("frame: {}\n", "'frame' needs 'origin'"),
        ("frame: {latitude: 47.4, longitude: 8.5}\n", "'frame' needs 'origin'"),
        ("frame: {origin: {latitude: 47.4, longitude: 8.5}}\n", "'origin' needs 'altitude'"),
        ("frame: {origin: {latitude: 91, longitude: 8.5, altitude: 0}}\n", "must be from -90 to 90, not 91"),
        ("frame: {origin: {latitude: .nan, longitude: 8.5, altitude: 0}}\n", "'.nan' is not a finite number"),
        ("frame: {origin: {latitude: 47, longitude: '8', altitude: 0}}\n", "'longitude' must be a number"),
        ("frame: {origin: {latitude: 47, longitude: 8, altitude: 0, up: 1}}\n", "'origin' has no key 'up'"),
        ("frame: 3\n", "'frame' must be a mapping"),
        ("hosts: {air: {frame: {north: 1}}}\n", "'frame' needs 'east'"),
        ("hosts: {air: {frame: {north: .inf, east: 0}}}\n", "'.inf' is not a finite number"),
        (
            "hosts: {air: {frame: {north: 0, east: 0, heading: 90}}}\n",
            "'heading' must be from -6.28319 to 6.28319",
        ),
        ("hosts: {air: {frame: {north: 0, east: 0, hedding: 1}}}\n", "did you mean 'heading'?"),
        ("hosts: {air: {frame: {latitude: 47, longitude: 8}}}\n", "the origin alone is in degrees"),
        ("hosts: {air: {pose: {north: 0, east: 0}}}\n", "'air' has no key 'pose'"),
        ("hosts: {grund: {frame: {north: 0, east: 0}}}\n", "the deployment has no host 'grund'"),
    ],
)
def test_mistakes_in_frames_are_reported_at_their_place(wrong, text, said):
    found = wrong(text + DEVICES)
    assert said in found
    assert "m.devices.yaml:1:" in found
    assert "^" in found


def test_a_simulated_unbound_device_has_a_place(reading):
    bound = reading(ORIGIN + HOSTS, simulate=True)
    fc = bound.devices["beta"]["fc"]
    assert fc.endpoint.startswith(SIMULATED)
    assert fc.frame == Placement(Origin(47.4, 8.5, 488.0), Pose(10.0, 20.0, -1.0), 1)


def test_frames_can_be_read_without_the_other_bindings(tmp_path):
    path = tmp_path / "m.devices.yaml"
    path.write_text(HOSTS + "agents: {alpha: {devices: {fc: {driver: none}}}}\n")
    assert read_frames(path, HOMES).agents == dict.fromkeys(("beta", "crane"), Pose(10.0, 20.0, -1.0))
    assert not read_frames(None, HOMES)
    path.write_text("hosts: [")
    with pytest.raises(BindingError):
        read_frames(path, HOMES)


MISSION = """\
resource Fork {
    init(string[] arg) { }
    portal synchronized lift(real height) emit real { return height; }
    portal synchronized lower(real height) emit real { return height; }
}

coordinator Boss {
    init(string[] arg) { Lift[] who = findLift("north > 1.0"); print(i2s(who.length())); }
}
"""
REGISTRY = """\
registry: 1
providers:
  Fork: {meaning: a fork, serves: {Lift: {}}}
agents:
  left: {east: 7.0}
"""


@pytest.fixture
def hall(tmp_path):
    (tmp_path / "m.L").write_text(MISSION)
    (tmp_path / "m.dL").write_text("//Fork:left@hall\n//Fork:right@hall\n//Fork:far@yard\n//Boss:boss@hall\n")
    (tmp_path / "m.capabilities.yaml").write_text(REGISTRY)
    (tmp_path / "m.devices.yaml").write_text(
        "hosts: {hall: {frame: {north: 2, east: 3}}}\n"
        "agents: {right: {frame: {north: 4, east: 5, down: -6}}}\n"
    )
    return tmp_path / "m.dL"


def test_an_agent_without_position_telemetry_is_at_its_pose(hall):
    mission = load_mission(hall)
    registry = mission.stated
    assert registry.agents == {
        "left": {"north": 2.0, "east": 7.0, "down": 0.0},
        "right": {"north": 4.0, "east": 5.0, "down": -6.0},
    }
    assert mission.registry.agents == {"left": {"east": 7.0}}


def test_a_bundle_has_the_frames_and_other_bindings_replace_them(hall, tmp_path):
    carried = bundle.decode(bundle.encode(load_mission(hall)))
    assert carried.bindings.frames == load_mission(hall).bindings.frames
    assert carried.stated.agents["right"]["down"] == -6.0
    other = tmp_path / "other.yaml"
    other.write_text("agents: {right: {frame: {north: 9, east: 9}}}\n")
    assert rebound(carried, other).stated.agents["right"] == {"north": 9.0, "east": 9.0, "down": 0.0}


@pytest.mark.parametrize(
    "pose", [Pose(float("nan"), 0.0), Pose(0.0, float("inf")), Pose(0.0, 0.0, 0.0, 99.0)]
)
def test_a_bundle_with_an_invalid_pose_is_refused(hall, pose):
    mission = load_mission(hall)
    frames = Frames(None, {}, {"right": pose}, mission.bindings.frames.everybody)
    broken = mission.with_bindings(mission.bindings.__class__(frames=frames))
    with pytest.raises(BundleError, match="pose"):
        bundle.decode(bundle.encode(broken))
