"""`fc.flyPlan("north-field.plan")`: the file is a part of the program, checked when the mission is built."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from lfield.errors import ProgramError
from lfield.mission import bundle
from lfield.mission.loader import check_file, compile_file, load_mission

PLAN = Path(__file__).parents[2] / "mavlink" / "files" / "north-field.plan"
PROGRAM = """const string FIELD = "north-field.plan";
resource Copter {{
    Mavlink fc;
    init(string[] arg) {{ }}
    portal survey(string name) {{ fc.waitReady(60.0); fc.arm(); fc.flyPlan({argument}); }}
}}
coordinator Boss {{ init(string[] arg) {{ findCopter("lead").survey("x"); print("surveyed"); }} }}
"""
BINDING = "{{driver: mavlink, endpoint: 'udp:127.0.0.1:1', ttl: 1.0, limits: {{{limits}}}, {options}}}"


@pytest.fixture
def mission(tmp_path):
    """Writes a mission whose call has this argument; gives the path of its deployment."""

    def write(argument="FIELD", limits="radius: 120.0, altitude: 30.0", options="autopilot: ardupilot"):
        (tmp_path / "north-field.plan").write_bytes(PLAN.read_bytes())
        (tmp_path / "mission.L").write_text(PROGRAM.format(argument=argument))
        (tmp_path / "mission.dL").write_text("//Copter:lead@alpha\n//Boss:one@alpha\n")
        device = BINDING.format(limits=limits, options=options)
        (tmp_path / "mission.devices.yaml").write_text(f"agents:\n  lead: {{devices: {{fc: {device}}}}}\n")
        return tmp_path / "mission.dL"

    return write


def refused(deployment):
    with pytest.raises(ProgramError) as error:
        load_mission(deployment)
    return [(finding.code, finding.span.text) for finding in error.value.diagnostics]


@pytest.mark.parametrize("argument", ["FIELD", '"north-field.plan"', '"./north-field.plan"'])
def test_the_file_is_a_constant_of_the_program(mission, argument, tmp_path):
    deployment = mission(argument)
    program = load_mission(deployment).program.core
    (text,) = [each for each in program.constants if isinstance(each, str) and "fileType" in each]
    assert text.startswith("north-field.plan\n")
    assert "survey" not in text
    assert list(check_file(deployment)) == []
    # A bundle does not need the file.
    data = bundle.encode(load_mission(deployment))
    (tmp_path / "north-field.plan").unlink()
    assert text in bundle.decode(data).program.core.constants


@pytest.mark.parametrize(
    ("argument", "code"),
    [
        ("name", "M301"),
        ('"south.plan"', "M302"),
        ('"mission.dL"', "M302"),
        ('"."', "M302"),
        ('"a\\0b"', "M302"),
    ],
)
def test_an_invalid_file_name_is_refused(mission, argument, code):
    deployment = mission(argument)
    assert refused(deployment) == [(code, argument)]
    with pytest.raises(ProgramError):
        compile_file(deployment.with_suffix(".L"))


@pytest.mark.parametrize(
    ("limits", "options", "codes"),
    [
        ("radius: 82.0", "autopilot: any", ["M104"] * 2),
        ("altitude: 10.0", "autopilot: any", [*["M104"] * 11, "M111"]),
        ("", "autopilot: px4", ["M102"]),
    ],
)
def test_the_plan_is_checked_against_the_binding(mission, limits, options, codes):
    assert refused(mission("FIELD", limits, options)) == [(code, "FIELD") for code in codes]


def test_a_plan_for_another_kind_of_vehicle_is_refused(mission):
    deployment = mission()
    plan = deployment.with_name("north-field.plan")
    plan.write_text(plan.read_text().replace('"vehicleType": 2', '"vehicleType": 10'))
    assert refused(deployment) == [("M101", "FIELD")]


@pytest.mark.few(0)
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_the_plan_is_flown_in_virtual_time(mission, lfield_mission, autopilot):
    options = f"autopilot: {autopilot}, waivers: {{autonomous_motion: a test, device_watchdog: a test}}"
    # PX4 returns 30 m above a rally point, which only the vehicle knows.
    deployment = mission("FIELD", "radius: 120.0, altitude: 60.0", options)
    if autopilot == "px4":
        plan = deployment.with_name("north-field.plan")
        plan.write_text(plan.read_text().replace('"firmwareType": 3', '"firmwareType": 12'))
    team = lfield_mission(deployment)
    team.run(until_done=True)
    assert team.ended == {"one": "done"}
    track = team.tracks["lead.fc"]
    assert max(point.north for point in track) == pytest.approx(80.0, abs=3.0)
    assert max(point.up for point in track) >= 19.0
    assert track[-1].up < 0.1


# -- areas -----------------------------------------------------------------------------------------------

AREA = """const string MAP = "north.kml";
coordinator Boss {{
    init(string[] arg) {{
        real[] field = mapArea({arguments});
        real sum = 0.0;
        for (int i = 0; i < field.length(); i = i + 1) sum = sum + field[i];
        print(i2s(field.length()) + " " + f2s(sum, 3));
    }}
}}
"""
MAP = PLAN.with_name("north.kml")
BOW = "<coordinates>8,47 8.1,47.1 8.1,47 8,47.1 8,47</coordinates>"
LINE = f"<kml><Placemark><LineString>{BOW}</LineString></Placemark></kml>"
EMPTY = "<Placemark><Polygon/></Placemark>"


def area(folder, arguments, kml=None):
    (folder / "north.kml").write_text(kml or MAP.read_text())
    (folder / "mission.L").write_text(AREA.format(arguments=arguments))
    (folder / "mission.dL").write_text("//Boss:one@alpha\n")
    return folder / "mission.dL"


@pytest.mark.parametrize("arguments", ["MAP", '"north.kml"', 'MAP, "north field"', 'MAP, "1"'])
def test_an_area_is_an_array(tmp_path, lfield_mission, arguments):
    team = lfield_mission(area(tmp_path, arguments))
    team.run(until_done=True)
    total = 2 * (47.3978766 + 47.3985055 + 8.5451295 + 8.5460585)
    assert team.said(f"8 {total:.3f}") == 1


def test_areas_are_allowed_in_functions_fields_and_classes(tmp_path, lfield_mission):
    deployment = area(tmp_path, "MAP")
    deployment.with_suffix(".L").write_text("""
const string MAP = "north.kml";
real[] whole() { return mapArea(MAP); }
class Box {
    private real[] inner;
    public Box() { inner = mapArea(MAP); }
    public int count() { return inner.length(); }
}
coordinator Boss {
    real[] own = mapArea(MAP);
    init(string[] arg) {
        Box box = new Box();
        print(whole().length() + own.length() + box.count());
    }
}
""")
    team = lfield_mission(deployment)
    team.run(until_done=True)
    assert team.said("24") == 1


def test_a_large_area_is_compiled(tmp_path):
    turns = [math.tau * n / 1000 for n in range(1000)]
    ring = " ".join(f"{8 + 0.01 * math.cos(a):.7f},{47 + 0.01 * math.sin(a):.7f}" for a in turns)
    start, end = MAP.read_text().split("<coordinates>")
    kml = f"{start}<coordinates>{ring}<{end.partition('<')[2]}"
    core = load_mission(area(tmp_path, "MAP", kml)).program.core
    assert len([each for each in core.constants if isinstance(each, float)]) > 1000


@pytest.mark.parametrize(
    ("arguments", "kml", "code"),
    [
        ("arg[0]", None, "M301"),
        ("MAP, arg[0]", None, "M301"),
        ('"south.kml"', None, "M302"),
        ('MAP, "south field"', None, "M302"),
        ("MAP", "<kml>", "M302"),
        ("MAP", LINE, "M302"),
        ("MAP", MAP.read_text().replace("</Document>", f"{EMPTY}</Document>"), "M302"),
        ("MAP", LINE.replace("LineString", "LinearRing"), "M202"),
    ],
)
def test_an_invalid_area_is_refused(tmp_path, arguments, kml, code):
    assert [each for each, _ in refused(area(tmp_path, arguments, kml))] == [code]


# -- surveys ---------------------------------------------------------------------------------------------

SURVEY = """const string MAP = "north.kml";
const real HEIGHT = 20.0;
const real SPACING = HEIGHT * 0.5 * (1.0 - 0.25);
coordinator Boss {{
    init(string[] arg) {{
        real[] strips = surveyStrips({arguments});
        print(i2s(strips.length() / 4) + " strips from " + f2s(strips[0], 5) + " to " + f2s(strips[2], 5));
    }}
}}
"""


def survey(folder, arguments, kml=None):
    deployment = area(folder, "MAP", kml)
    deployment.with_suffix(".L").write_text(SURVEY.format(arguments=arguments))
    return deployment


@pytest.mark.parametrize("arguments", ["MAP, SPACING, 0", 'MAP, "north field", SPACING, 0.0'])
def test_a_survey_is_an_array_of_strips(tmp_path, lfield_mission, arguments):
    team = lfield_mission(survey(tmp_path, arguments))
    team.run(until_done=True)
    # The field is 70 by 70 m.
    assert team.said("10 strips from 47.39788 to 47.39851") == 1


@pytest.mark.parametrize(
    ("arguments", "kml", "code"),
    [
        ("MAP, s2f(arg[0]), 0", None, "M301"),
        ("arg[0], 10, 0", None, "M301"),
        ("MAP, 0.1, 0", None, "M303"),
        ("MAP, 10, 360", None, "M303"),
        ("MAP, 10, -1", None, "M303"),
        ("MAP, 10, 0", LINE.replace("LineString", "LinearRing"), "M202"),
        ("MAP, 10, 0", LINE, "M302"),
    ],
)
def test_an_invalid_survey_is_refused(tmp_path, arguments, kml, code):
    assert [each for each, _ in refused(survey(tmp_path, arguments, kml))] == [code]
