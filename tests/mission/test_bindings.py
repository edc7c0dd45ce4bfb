from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from lfield.driver.binding import SIMULATED, OrphanPolicy, longest_rest
from lfield.driver.driver_index import DriverIndex, DriverInfo
from lfield.driver.manifest_file import load_manifest
from lfield.driver.plugins import Plugins
from lfield.errors import BindingError, InputFileError
from lfield.mission.bindings import SIM_SILENCE, on_fakes
from lfield.mission.bindings_file import read_bindings
from lfield.mission.loader import mission_problems

NEEDED = {"alpha": {"fc": "Mavlink"}, "beta": {"fc": "Mavlink"}, "tour": {}}

GOOD = """\
agents:
  alpha:
    heap: 2 MiB
    call_depth: 50
    devices:
      fc: {driver: mavlink, endpoint: "udp:127.0.0.1:14550", system: 3, ttl: 0.3, safe_state: hold,
           limits: {speed: 5}}
  beta:
    devices:
      fc:
        driver: mavlink
        endpoint: "tcp:127.0.0.1:5760"
        kind: rover
  tour: {threads: 4, tidy: 2.5}
defaults: {heap: 512 KiB, string_length: 1000}
unreachable_after: 4
"""


@pytest.fixture(scope="module")
def plugins() -> Plugins:
    plugins = Plugins()
    plugins.add("lfield_mavlink:PLUGIN")
    return plugins


@pytest.fixture
def written(tmp_path):
    def write(text: str) -> Path:
        path = tmp_path / "m.devices.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def problems(path, plugins, needed=NEEDED, **options) -> str:
    with pytest.raises(BindingError) as error:
        read_bindings(path, needed, plugins, **options)
    return "\n".join(error.value.problems)


def test_a_devices_file_is_read(written, plugins):
    bindings = read_bindings(written(GOOD), NEEDED, plugins)
    alpha, beta = bindings.devices["alpha"]["fc"], bindings.devices["beta"]["fc"]
    assert (alpha.name, alpha.endpoint, alpha.ttl, alpha.safe_state) == (
        "alpha.fc", "udp:127.0.0.1:14550", 0.3, "hold",
    )  # fmt: skip
    assert alpha.limits == {"speed": 5.0}
    assert (alpha.option("system"), alpha.option("kind")) == (3, "copter")
    assert (beta.option("system"), beta.option("kind"), beta.safe_state) == (1, "rover", "land")
    assert bindings.unreachable_after == 4.0
    assert [d.name for d in bindings.of(["beta", "tour"])] == ["beta.fc"]


def test_limits_of_agents_override_the_defaults(written, plugins):
    bindings = read_bindings(written(GOOD), NEEDED, plugins)
    alpha, tour = bindings.limits("alpha"), bindings.limits("tour")
    assert (alpha.heap, alpha.call_depth, alpha.string_length) == (2 << 20, 50, 1000)
    assert (tour.heap, tour.threads, tour.string_length) == (512 << 10, 4, 1000)
    assert (alpha.tidy, tour.tidy) == (5.0, 2.5)
    assert read_bindings(None, {"x": {}}, plugins).limits("x").heap == 1 << 20


def test_reservation_lease_and_wait_are_read(written, plugins):
    usual = read_bindings(written(GOOD), NEEDED, plugins)
    assert (usual.reservations.lease, usual.reserved_wait("alpha")) == (6.0, 5.0)
    text = (
        GOOD.replace("threads: 4", "threads: 4, reserved_wait: 0") + "reservations: {lease: 2, wait: 1.5}\n"
    )
    bindings = read_bindings(written(text), NEEDED, plugins)
    assert bindings.reservations.lease == 2.0
    assert (bindings.reserved_wait("tour"), bindings.reserved_wait("alpha")) == (0.0, 1.5)


@pytest.mark.parametrize(
    ("old", "new", "drawn"),
    [
        ("  alpha:\n", "  alfa:\n", ":2:3: error[Y113]: the deployment has no agent 'alfa'"),
        ("      fc: {driver", "      fx: {driver", ":6:7: error[Y113]: alpha has no device 'fx'"),
        ("{driver: mavlink", "{driver: mavlnk", ":6:20: error[Y113]: there is no driver 'mavlnk'"),
        ("{driver: mavlink, ", "{", ":6:11: error[Y110]: 'fc' needs 'driver'"),
        ("{driver: mav", "{driver:mav", "hint: write a space after the colon: driver: mavlink"),
        ('endpoint: "udp:127.0.0.1:14550", ', "", "error[Y110]: 'fc' needs 'endpoint'"),
        ("system: 3", "system: 300", "error[Y113]: 'system' must be from 1 to 254, not 300"),
        ("system: 3", "system: three", "error[Y112]: 'system' must be a whole number, not the text 'three'"),
        ("system: 3", "sistem: 3", "hint: did you mean 'system'?"),
        (
            "agents:\n",
            "engine: wasmtime\nagents:\n",
            ":1:9: error[Y113]: 'engine' must be one of auto, wasm,",
        ),
        ("ttl: 0.3", "ttl: 0", "error[Y113]: 'ttl' must be from 0.02 to 60, not 0"),
        (
            "safe_state: hold",
            "safe_state: hover",
            "error[Y113]: 'safe_state' must be one of land, hold, return",
        ),
        ("{speed: 5}", "{speed: fast}", "error[Y112]: 'speed' must be a number"),
        ("{speed: 5}", "{sped: 5}", "error[Y111]: 'limits' has no key 'sped'"),
        ("kind: rover", "kind: boat", ":13:15: error[Y113]: 'kind' must be one of copter, rover"),
        ("heap: 2 MiB", "heap: 2 MB", ":3:11: error[Y112]: 'heap' must be a size from 4 KiB to 2 GiB"),
        ("tidy: 2.5", "tidy: -1", "error[Y113]: 'tidy' must be from 0 to 600, not -1"),
        ("heap: 2 MiB", "heap: 1 B", "error[Y112]: 'heap' must be a size"),
        ("heap: 2 MiB", "heep: 2 MiB", ":3:5: error[Y111]: 'alpha' has no key 'heep'"),
        (
            "unreachable_after: 4",
            "unreachable: 4",
            ":16:1: error[Y111]: a devices file has no key 'unreachable'",
        ),
        (
            "unreachable_after: 4",
            "reservations: {lease: 0.1}",
            ":16:23: error[Y113]: 'lease' must be from 0.5 to 600, not 0.1",
        ),
        ("unreachable_after: 4", "reservations: {wait: -1}", "'wait' must be from 0 to 3600, not -1"),
        ("unreachable_after: 4", "reservations: {waits: 1}", "'reservations' has no key 'waits'"),
        ("threads: 4", "reserved_wait: soon", "error[Y112]: 'reserved_wait' must be a number"),
        ("threads: 4", "threads: 0", "error[Y113]: 'threads' must be from 1 to 65536, not 0"),
    ],
)
def test_mistakes_are_reported_at_their_place(written, plugins, old, new, drawn):
    assert old in GOOD
    assert drawn in problems(written(GOOD.replace(old, new, 1)), plugins)


def test_all_mistakes_are_reported_at_once(written, plugins):
    text = (
        GOOD.replace("system: 3", "system: 300")
        .replace("kind: rover", "kind: boat")
        .replace("threads", "thread")
    )
    assert problems(written(text), plugins).count("error[") == 3


SERVOS = """\
agents:
  arm:
    devices:
      joints:
        {driver: dynamixel, endpoint: "serial:/dev/ttyACM0:1000000", protocol: 0, ids: [1, 2], lowest: -1,
         highest: [1.5, 2], calibration: arm.json}
"""
CALIBRATION = """{
    "pan": {"id": 1, "drive_mode": 0, "homing_offset": -120, "range_min": 800, "range_max": 3000},
    "lift": {"id": 2, "drive_mode": 0, "homing_offset": 300, "range_min": 900, "range_max": 2800}
}"""


@pytest.mark.parametrize(
    ("old", "new", "drawn"),
    [
        ("-1,", "low,", ":5:104: error[Y112]: 'lowest' must be a number, or a list of numbers"),
        ("[1.5, 2]", "[1.5, true]", "error[Y112]: 'highest' must be a number, or a list of numbers"),
        ("[1.5, 2]", "[1, 2, 3]", "'highest' must be one value for all, or 2, one for each id, not 3"),
        ("ids: [1, 2]", "ids: [1, 7]", "arm.json: it has no joint of servo 7"),
        ("ids: [1, 2]", "ids: [1, 1]", "its binding names servo 1 twice; give each servo its own id"),
        ("arm.json", "hand.json", "error[Y113]: there is no file"),
        ('"range_max": 3000', '"range_max": 30', "error[Y113]: "),
        (
            '"range_max": 3000',
            '"range_max": 30',
            "joint 'pan': its range is reversed (range_min 800, range_max 30)",
        ),
    ],
)
def test_joints_and_their_calibration_are_checked(written, tmp_path, old, new, drawn):
    servos, needed = Plugins(), {"arm": {"joints": "DynamixelGroup"}}
    servos.add("lfield_dynamixel:PLUGIN")
    file, path = tmp_path / "arm.json", written(SERVOS)
    file.write_text(CALIBRATION)
    options = read_bindings(path, needed, servos).devices["arm"]["joints"].options
    assert (options["lowest"], options["highest"]) == ([-1.0], [1.5, 2.0])
    assert (options["direction"], options["offset"], options["calibration"]) == ([1], [0.0], str(file))
    assert old in SERVOS + CALIBRATION
    file.write_text(CALIBRATION.replace(old, new))
    assert drawn in problems(written(SERVOS.replace(old, new)), servos, needed)


def test_an_unbound_device_is_reported(written, plugins):
    findings = problems(written("agents: {alpha: {}}\n"), plugins)
    assert "alpha.fc (Mavlink) is not bound in" in findings
    assert "beta.fc (Mavlink) is not bound in" in findings
    assert "alpha.fc (Mavlink) is not bound and there is no devices file" in problems(None, plugins)


def test_a_device_type_without_a_driver_is_reported(plugins):
    findings = problems(None, plugins, {"alpha": {"arm": "Robot"}}, simulate=True)
    assert findings == "alpha.arm: no installed driver provides a Robot (device types installed: Mavlink)"


def test_a_driver_of_another_type_is_reported(written, plugins):
    findings = problems(written(GOOD), plugins, {**NEEDED, "alpha": {"fc": "Servo"}})
    assert "driver 'mavlink' provides a Mavlink, but fc is a Servo" in findings


def test_simulation_needs_no_file(plugins):
    fc = read_bindings(None, NEEDED, plugins, simulate=True).devices["beta"]["fc"]
    assert (fc.driver, fc.endpoint, fc.safe_state, fc.option("system")) == (
        "mavlink",
        SIMULATED + "beta.fc",
        "land",
        1,
    )


def test_simulation_keeps_the_bindings_but_the_endpoint(written, plugins):
    fc = read_bindings(written(GOOD), NEEDED, plugins, simulate=True).devices["alpha"]["fc"]
    assert (fc.endpoint, fc.option("system"), fc.limits, fc.safe_state) == (
        SIMULATED + "udp:127.0.0.1:14550",
        3,
        {"speed": 5.0},
        "hold",
    )


def test_the_silence_of_a_simulated_host_is_fixed(written, plugins):
    field = read_bindings(written(GOOD + "silence: 0.1\n"), NEEDED, plugins)
    assert field.silence == 0.1
    assert read_bindings(written(GOOD), NEEDED, plugins).silence == 0.2
    assert on_fakes(field, NEEDED, plugins).silence == SIM_SILENCE == 2.0
    assert (
        read_bindings(written(GOOD + "silence: 9\n"), NEEDED, plugins, simulate=True).silence == SIM_SILENCE
    )
    assert read_bindings(None, NEEDED, plugins, simulate=True).silence == SIM_SILENCE


def test_the_file_selects_the_engine(written, plugins):
    assert read_bindings(written(GOOD), NEEDED, plugins).engine == "auto"
    assert read_bindings(written(GOOD + "engine: reference\n"), NEEDED, plugins).engine == "reference"


def test_a_missing_file_is_an_input_error(plugins, tmp_path):
    with pytest.raises(InputFileError):
        read_bindings(tmp_path / "none.yaml", NEEDED, plugins)


def test_a_sensor_is_bound_without_a_safe_state(written, sensor):
    good = "agents: {alpha: {devices: {eye: {driver: eye, endpoint: here}}}}"
    needed = {"alpha": {"eye": "Eye"}}
    bound = read_bindings(written(good), needed, sensor).devices["alpha"]["eye"]
    assert bound.is_sensor
    assert longest_rest([bound]) == 0.0
    found = problems(written(good.replace("here}", "here, safe_state: off}")), sensor, needed)
    assert "a Eye only senses: it has no safe state" in found


@pytest.fixture
def sensor():
    """A driver whose only device is a sensor."""
    eye = load_manifest("eye/m.yaml", b"driver: eye\ntype: Eye\ntelemetry: {light: {type: real}}\n")
    return DriverIndex({"eye": DriverInfo("eye", "eye:PLUGIN", {"Eye": eye}, {}, "eye")})


WITHOUT_POLICY = """\
agents:
  alpha:
    devices:
      fc: {{driver: mavlink, endpoint: "udp:127.0.0.1:14550", without_policy: {}}}
"""


def test_the_behaviour_without_a_policy_is_read(written, plugins):
    path = written(WITHOUT_POLICY.format("{after: 30, do: hold}"))
    (device,) = read_bindings(path, {"alpha": {"fc": "Mavlink"}}, plugins).all
    assert device.without_policy == OrphanPolicy(30.0, "hold")
    path = written(WITHOUT_POLICY.replace(", without_policy: {}", "").replace("}}", "}").replace("{{", "{"))
    (device,) = read_bindings(path, {"alpha": {"fc": "Mavlink"}}, plugins).all
    assert device.without_policy is None


@pytest.mark.parametrize(
    ("written_as", "words"),
    [
        ("{after: 30, do: lnd}", "'do' must be one of land, hold, return"),
        ("{after: 30}", "'without_policy' needs 'do'"),
        ("{do: land}", "'without_policy' needs 'after'"),
        ("{after: 1, do: land}", "'after' must be from 5 to 86400, not 1"),
        ("{after: .nan, do: land}", "'.nan' is"),
        ("{after: 30, do: land, then: 2}", "'without_policy' has no key 'then'"),
        ("land", "'without_policy' must be a mapping, not"),
    ],
)
def test_an_invalid_behaviour_without_a_policy_is_reported_at_its_place(written, plugins, written_as, words):
    findings = problems(written(WITHOUT_POLICY.format(written_as)), plugins, {"alpha": {"fc": "Mavlink"}})
    assert words in findings
    assert "m.devices.yaml:4:" in findings
    assert "^" in findings


def test_a_deployment_is_checked_with_the_devices_file_beside_it(tmp_path):
    (tmp_path / "m.L").write_text("resource Copter { Mavlink fc; init(string[] arg) { } }\n")
    (tmp_path / "m.dL").write_text("//Copter:alpha@host\n//Copter:beta@host\n")
    assert mission_problems(tmp_path / "m.dL") == []
    devices = tmp_path / "m.devices.yaml"
    devices.write_text(WITHOUT_POLICY.format("{after: 30, do: land}"))
    (found,) = mission_problems(tmp_path / "m.dL")
    assert found.severity == "warning"
    assert found.render().startswith(f"warning[bindings]: beta.fc (Mavlink) is not bound in {devices}: add ")
    devices.write_text(WITHOUT_POLICY.format("{after: 30, do: lnd}"))
    (found,) = mission_problems(tmp_path / "m.dL")
    problem = found.render()
    assert "did you mean 'land'?" in problem


def test_attributes_stated_in_two_files_are_reported_by_check(tmp_path):
    (tmp_path / "m.L").write_text(
        "include <can/winch.L>;\ncoordinator Boss { init(string[] arg) { findLift(); } }\n"
    )
    (tmp_path / "m.dL").write_text("//Winch:hoist@host?1&2&3\n//Boss:boss@host\n")
    (tmp_path / "m.capabilities.yaml").write_text("registry: 1\nagents: {hoist: {mass: 3.0}}\n")
    (tmp_path / "m.devices.yaml").write_text("agents: {hoist: {attributes: {mass: 8, payload: 5}}}\n")
    unbound, found = mission_problems(tmp_path / "m.dL")
    assert "is not bound" in unbound.render()
    assert (found.severity, found.render()) == (
        "warning",
        "warning[bindings]: mass of hoist is stated in the devices file and in the mission's registry, "
        "which counts",
    )


ENDPOINTS = """\
agents:
  alpha: {{devices: {{fc: {{driver: mavlink{}}}}}}}
  beta: {{devices: {{fc: {{driver: mavlink, endpoint: "udp:127.0.0.1:1, serial:/dev/ttyUSB0:57600"}}}}}}
"""


@pytest.mark.parametrize(
    ("endpoint", "told"),
    [
        ("", "2:25: error[Y110]: 'fc' needs 'endpoint'"),
        (", endpoint: ''", "2:53: error[Y113]: '' is not an endpoint; write udp:HOST:PORT, "),
        (", endpoint: 'foo:bar'", "2:53: error[Y113]: 'foo:bar' is not an endpoint; write udp:"),
        (", endpoint: 'can:can0'", "2:53: error[Y113]: 'can:can0' is not an endpoint; write udp:"),
        (
            ", endpoint: 'udp:127.0.0.1:99999'",
            "2:53: error[Y113]: 'udp:127.0.0.1:99999': the port '99999' is not a number",
        ),
        (
            ", endpoint: 'serial:/dev/x:fast'",
            "2:53: error[Y113]: 'serial:/dev/x:fast' is not a serial endpoint",
        ),
        (
            ", endpoint: 'udp:127.0.0.1:1,tcp:h:x'",
            "2:53: error[Y113]: 'tcp:h:x': the port 'x' is not a number",
        ),
        (", endpoint: 14550", "2:53: error[Y112]: 'endpoint' must be text, not the number 14550"),
    ],
)
def test_an_invalid_endpoint_is_reported_at_its_place(written, plugins, tmp_path, endpoint, told):
    path = written(ENDPOINTS.format(endpoint))
    assert problems(path, plugins).startswith(f"{path}:{told}")
    (tmp_path / "m.L").write_text("resource Copter { Mavlink fc; init(string[] arg) { } }\n")
    (tmp_path / "m.dL").write_text("//Copter:alpha@host\n//Copter:beta@host\n")
    (found,) = mission_problems(tmp_path / "m.dL")
    assert (found.severity, found.render().startswith(f"{path}:{told}")) == ("error", True)
    if (
        "Y112" not in told
    ):  # A fake does not use the endpoint; a value that is not text is an error there too.
        read_bindings(path, NEEDED, plugins, simulate=True)


def test_endpoints_of_a_driver_that_is_not_installed_are_not_validated(written, plugins):
    there = plugins.by_driver["mavlink"].without_local_parts
    elsewhere = replace(there, reference="nowhere_at_all:PLUGIN")
    path = written(ENDPOINTS.format(", endpoint: 'foo:bar'"))
    assert read_bindings(path, NEEDED, DriverIndex({"mavlink": elsewhere})).devices["alpha"]
    assert "'foo:bar' is not an endpoint" in problems(path, DriverIndex({"mavlink": there}))


WAIVED = """\
agents:
  alpha: {devices: {fc: {driver: mavlink, endpoint: "udp:127.0.0.1:14550", waivers: %s}}}
  beta: {devices: {fc: {driver: mavlink, endpoint: "udp:127.0.0.1:14560", system: 2}}}
"""


@pytest.mark.parametrize(
    ("waivers", "names", "reasons"),
    [
        ("[device_watchdog]", ["device_watchdog"], {}),
        ("{autonomous_motion: a pilot}", ["autonomous_motion"], {"autonomous_motion": "a pilot"}),
        (
            "[device_watchdog, {autonomous_motion: a pilot}]",
            ["device_watchdog", "autonomous_motion"],
            {"autonomous_motion": "a pilot"},
        ),
        ("", [], {}),
    ],
)
def test_a_waiver_may_have_a_reason(written, plugins, waivers, names, reasons):
    found = read_bindings(written(WAIVED % waivers), NEEDED, plugins)
    alpha = found.devices["alpha"]["fc"]
    assert (alpha.waivers, alpha.reasons) == (names, reasons)


@pytest.mark.parametrize(
    ("waivers", "told"),
    [
        ("[autonomous_motion]", "error[Y110]: 'autonomous_motion' is waived without a reason"),
        ("{autonomous_motion: ' '}", "error[Y110]: 'autonomous_motion' is waived without a reason"),
        ("{autonomous: why}", "error[Y113]: unknown waiver 'autonomous'"),
        ("[3]", "error[Y112]: 'waivers' must be names, or names with a reason each"),
        ("device_watchdog", "error[Y112]: 'waivers' must be names, or names with a reason each"),
    ],
)
def test_an_invalid_waiver_or_a_missing_reason_is_reported(written, plugins, waivers, told):
    assert told in problems(written(WAIVED % waivers), plugins)


def test_a_station_id_of_a_ground_station_is_refused(written, plugins):
    text = (WAIVED % "[device_watchdog]").replace("system: 2", "system: 2, station: 255")
    assert "'station' must be from 0 to 254, not 255" in problems(written(text), plugins)


@pytest.mark.parametrize(
    ("lead", "other", "told"),
    [
        ("system: 1", "system: 128", "alpha.fc: its station has the system id 128, which belongs to beta.fc"),
        (
            "system: 1",
            "system: 2, station: 128",
            "beta.fc: its station has the system id 128, as has that",
        ),
        (
            "system: 3, station: 3",
            "system: 4",
            "alpha.fc: its station has the system id 3, which belongs to itself",
        ),
        ("system: 1", "system: 2", ""),
        # On one network they could not be distinguished, so there are two.
        ("system: 1", "system: 1", ""),
    ],
)
def test_stations_of_all_endpoints_are_compared(written, plugins, lead, other, told):
    """Links may lead to one network: a station that another vehicle hears prevents its landing."""
    fc = "{driver: mavlink, endpoint: 'udp:127.0.0.1:%d', %s}"
    agents = {"alpha": fc % (1, lead), "beta": fc % (2, other)}
    lines = [f"  {agent}: {{devices: {{fc: {device}}}}}\n" for agent, device in agents.items()]
    path = written("agents:\n" + "".join(lines))
    if told:
        findings = problems(path, plugins)
        assert told in findings
        assert "choose another by 'station: ID'" in findings
        assert read_bindings(path, NEEDED, plugins, simulate=True)
    else:
        assert read_bindings(path, NEEDED, plugins)
