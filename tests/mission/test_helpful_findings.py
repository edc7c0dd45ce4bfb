"""`check` finds inconsistencies between the files of a mission, with place and hint."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from lfield.bytecode.encoding import decode, encode
from lfield.driver.network import is_host
from lfield.errors import DeviceError, ProgramFileError, ReportableFinding
from lfield.mission.loader import check_file, compile_file, load_mission, mission_problems
from lfield_mavlink.link.links import parse_endpoint

PROGRAM = """
include <mavlink/mavlink.L>;
resource SurveyRover {
    Mavlink fc;
    init(string[] arg) { }
    portal go() { fc.arm(); }
}
coordinator Boss {
    init(string[] arg) {
        SurveyRover one = findSurveyRover(arg[1]);
        one.go();
        print(arg[3]);
        if (arg[2] == "more") print(arg[9]);
    }
}
"""
DEPLOYMENT = "//SurveyRover:rover1@alpha\n//Boss:boss@alpha?rover1&b&c\n"
DEVICES = 'agents: {rover1: {devices: {fc: {driver: mavlink, endpoint: "udpin:127.0.0.1:14550"}}}}\n'


def mission(folder: Path, deployment: str = DEPLOYMENT, devices: str = DEVICES) -> Path:
    include = "include <mavlink/mavlink.L>;\n"
    (folder / "m.L").write_text(PROGRAM.replace(include, ""))
    (folder / "m.dL").write_text(deployment)
    (folder / "m.devices.yaml").write_text(devices)
    return folder / "m.dL"


def found(path: Path) -> list[tuple[object, object, object]]:
    """Severity, code and line of all findings."""
    findings: list[ReportableFinding] = list(check_file(path))
    if not any(finding.severity == "error" for finding in findings):
        findings += mission_problems(path)
    return [line_of(finding) for finding in findings]


def line_of(finding: ReportableFinding) -> tuple[object, object, object]:
    data = finding.as_data()
    place = data["range"]
    return data["severity"], data["code"], place["start"]["line"] if isinstance(place, dict) else None


def test_arguments_with_commas_are_to_be_separated_by_ampersands(tmp_path: Path) -> None:
    (finding,) = check_file(mission(tmp_path, DEPLOYMENT.replace("rover1&b&c", "rover1,b,c")))[:1]
    assert (finding.as_data()["code"], finding.as_data()["hint"]) == (
        "L716",
        "separate arguments by &: ?rover1&b&c",
    )


def test_a_valid_mission_has_no_findings(tmp_path: Path) -> None:
    assert found(mission(tmp_path)) == []


def test_an_argument_that_init_reads_but_the_deployment_lacks_is_an_error(tmp_path: Path) -> None:
    short = DEPLOYMENT.replace("?rover1&b&c", "?rover1&b")
    assert found(mission(tmp_path, short)) == [("error", "L716", 2)]


def test_an_argument_read_under_a_condition_may_be_missing(tmp_path: Path) -> None:
    assert ("error", "L716", 2) not in found(mission(tmp_path))


@pytest.mark.parametrize(
    ("line", "is_found"),
    [
        ("try { print(arg[3]); } finally { }", True),
        ("try { } finally { print(arg[3]); }", True),
        ("try { print(arg[3]); } catch (Exception e) { }", False),
        ("while (true) { print(arg[3]); }", True),
        ("while (arg[3] == arg[1]) { }", True),
        ("while (arg[1] == arg[2]) { print(arg[3]); }", False),
    ],
)
def test_an_argument_read_in_a_block_that_is_always_entered_is_required(
    tmp_path: Path, line: str, is_found: bool
) -> None:
    path = mission(tmp_path, DEPLOYMENT.replace("?rover1&b&c", "?rover1&b"))
    program = path.with_suffix(".L")
    program.write_text(program.read_text().replace("print(arg[3]);", line))
    assert (("error", "L716", 2) in found(path)) == is_found


@pytest.mark.parametrize("index", ["9223372036854775807", "2147483648", "-1", "1 + 2"])
def test_an_argument_with_any_constant_index_is_required(tmp_path: Path, index: str) -> None:
    """An index of billions gives a short hint, without a placeholder for each argument."""
    path = mission(tmp_path, DEPLOYMENT.replace("?rover1&b&c", "?rover1&b"))
    program = path.with_suffix(".L")
    program.write_text(program.read_text().replace("arg[3]", f"arg[{index}]"))
    (finding,) = check_file(path)
    assert line_of(finding) == ("error", "L716", 2)
    assert len(str(finding.as_data()["hint"])) < 200


def test_an_argument_that_is_not_an_agent_id_is_a_warning(tmp_path: Path) -> None:
    path = mission(tmp_path, DEPLOYMENT.replace("?rover1", "?rovr1"))
    finding = check_file(path)[0]
    assert line_of(finding) == ("warning", "L907", 2)
    assert finding.as_data()["hint"] == "did you mean 'rover1'?"


def test_a_constant_id_that_the_deployment_lacks_is_a_warning(tmp_path: Path) -> None:
    path = mission(tmp_path)
    program = path.with_suffix(".L")
    program.write_text(program.read_text().replace("(arg[1])", '("rover2")'))
    assert found(path) == [("warning", "L907", 9)]


def test_a_misspelt_host_is_a_warning_and_numbered_hosts_are_not(tmp_path: Path) -> None:
    text = f"{DEPLOYMENT}//SurveyRover:rover2@aplha\n//@alpha2\n"
    devices = DEVICES.replace(
        "rover1: {", "rover2: {devices: {fc: {driver: mavlink, endpoint: 'tcp:h:1'}}}, rover1: {"
    )
    path = mission(tmp_path, text, devices)
    finding = check_file(path)[0]
    assert line_of(finding) == ("warning", "L906", 3)
    assert finding.as_data()["hint"] == "did you mean 'alpha'?"


@pytest.mark.parametrize("simulate", [True, False])
def test_the_kind_of_a_vehicle_follows_from_its_resource(tmp_path: Path, simulate: bool) -> None:
    loaded = load_mission(mission(tmp_path), simulate=simulate)
    assert loaded.bindings.devices["rover1"]["fc"].options["kind"] == "rover"


@pytest.mark.parametrize(("kind", "findings"), [("rover", []), ("copter", [("error", "Y113", 1)])])
def test_a_bound_kind_must_not_contradict_the_resource(
    tmp_path: Path, kind: str, findings: list[object]
) -> None:
    devices = DEVICES.replace("driver: mavlink", f"driver: mavlink, kind: {kind}")
    assert found(mission(tmp_path, devices=devices)) == findings


def renamed(tmp_path: Path, resource: str, agent: str) -> Path:
    """The mission with other names of the resource and its agent."""
    path = mission(tmp_path)
    for file in tmp_path.iterdir():
        text = file.read_text().replace("SurveyRover", resource).replace("rover1", agent)
        file.write_text(text)
    return path


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("resource", "agent", "kind"),
    [
        ("Truck", "one", "rover"),
        ("UGV", "one", "rover"),
        ("Vehicle", "husky", "rover"),
        ("Vehicle", "rover1", "rover"),
        ("Vehicle", "drone1", "copter"),
        ("SurveyCopter", "rover1", "copter"),
    ],
)
@pytest.mark.parametrize("simulate", [True, False])
def test_known_words_in_names_decide_the_kind(
    tmp_path: Path, resource: str, agent: str, kind: str, simulate: bool
) -> None:
    path = renamed(tmp_path, resource, agent)
    assert found(path) == []
    loaded = load_mission(path, simulate=simulate)
    assert loaded.bindings.devices[agent]["fc"].options["kind"] == kind


def test_an_agent_id_never_contradicts_a_stated_kind(tmp_path: Path) -> None:
    path = renamed(tmp_path, "Vehicle", "rover1")
    path.with_name("m.devices.yaml").write_text(
        DEVICES.replace("driver: mavlink", "driver: mavlink, kind: submarine")
    )
    assert found(path) == []
    assert load_mission(path).bindings.devices["rover1"]["fc"].options["kind"] == "submarine"


def test_a_kind_that_no_name_decides_is_a_warning(tmp_path: Path) -> None:
    path = renamed(tmp_path, "Vehicle", "one")
    (finding,) = mission_problems(path)
    assert line_of(finding) == ("warning", "Y116", 1)
    assert finding.as_data()["hint"] == "write kind: copter or rover"
    stated = DEVICES.replace("rover1", "one").replace("driver: mavlink", "driver: mavlink, kind: copter")
    path.with_name("m.devices.yaml").write_text(stated)
    assert found(path) == []


def test_a_misspelt_limit_lists_all_limits(tmp_path: Path) -> None:
    devices = DEVICES.replace("driver: mavlink", "driver: mavlink, limits: {hight: 10}")
    finding = mission_problems(mission(tmp_path, devices=devices))[0].as_data()
    assert finding["code"] == "Y111"
    assert finding["hint"] == "known keys: altitude, radius, speed"


@pytest.mark.parametrize(
    "endpoint", ["udp://127.0.0.1:14550", "udp:192.168.1..5:14550", "ucp://h:1", "tcp://h:PORT"]
)
def test_an_implausible_endpoint_is_an_error(tmp_path: Path, endpoint: str) -> None:
    devices = DEVICES.replace("udpin:127.0.0.1:14550", endpoint)
    assert found(mission(tmp_path, devices=devices)) == [("error", "Y113", 1)]


@pytest.mark.parametrize(
    ("url", "endpoint"),
    [
        ("udp://:14540", "udpin:0.0.0.0:14540"),
        ("udpin://0.0.0.0:14540", "udpin:0.0.0.0:14540"),
        ("udpout://10.0.0.2:14550", "udp:10.0.0.2:14550"),
        ("tcp://10.0.0.2:5760", "tcp:10.0.0.2:5760"),
        ("tcp://[::1]:5760", "tcp:[::1]:5760"),
        ("serial:///dev/ttyUSB0:57600", "serial:/dev/ttyUSB0:57600"),
    ],
)
def test_urls_of_mavsdk_are_endpoints(url: str, endpoint: str) -> None:
    assert parse_endpoint(url) == parse_endpoint(endpoint)


def test_a_url_with_two_meanings_shows_both_spellings() -> None:
    with pytest.raises(DeviceError) as refused:
        parse_endpoint("udp://10.0.0.2:14550")
    assert "udpin:10.0.0.2:14550" in refused.value.reason
    assert "udp:10.0.0.2:14550" in refused.value.reason


def test_names_and_addresses_of_hosts_are_validated() -> None:
    good = ["localhost", "rover-1", "rover_1.local", "10.0.0.2", "::1", "fe80::1%wlan0", "a.b.c."]
    bad = ["192.168.1..5", "192.168.1", "300.1.1.1", "", "-a", "a b", "a..b", "x" * 300]
    assert [host for host in good if not is_host(host)] == []
    assert [host for host in bad if is_host(host)] == []


def test_a_host_with_an_ipv6_address_may_be_named_without_brackets(tmp_path: Path) -> None:
    loaded = load_mission(mission(tmp_path, DEPLOYMENT.replace("@alpha", "@[::1]")))
    assert loaded.team.find_host("::1") == loaded.team.find_host("[::1]") == "[::1]"


def test_the_error_for_a_damaged_program_file_has_no_text_of_libraries(tmp_path: Path) -> None:
    data = encode(compile_file(mission(tmp_path).with_suffix(".L"))[0])
    header, body = data[:44], data[44:].replace(b"SurveyRover", b"Survey\xffover")
    not_utf8 = header[:8] + hashlib.sha256(body).digest() + header[40:] + body
    for damaged in (data[:-1] + b"\xff", b"\xff\xfe not a program", data[:40], not_utf8):
        with pytest.raises(ProgramFileError) as refused:
            decode(damaged)
        assert not any(word in refused.value.reason for word in ("utf-8", "codec", "msgpack", "0xff"))
