"""`lfield check --json`: one object for each finding, with its range."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lfield.cli.main import main

PROGRAM = """resource Arm {
    init(string[] arg) { }
    private int f() {
        if (x > 0) return 1;
    }
}
"""


def findings(capsys: pytest.CaptureFixture[str], *files: Path) -> tuple[int, list[dict[str, object]]]:
    status = main(["check", "--json", *map(str, files)])
    out, err = capsys.readouterr()
    assert err == ""
    return status, json.loads(out)


def test_a_finding_has_its_range(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program, deployment = tmp_path / "m.L", tmp_path / "m.dL"
    program.write_text(PROGRAM)
    deployment.write_text("//Arm:a\x1b[31mb@here\n")
    status, found = findings(capsys, program, deployment)
    assert status == 65
    assert found == [
        {
            "file": str(program),
            "range": {"start": {"line": 4, "column": 13}, "end": {"line": 4, "column": 14}},
            "severity": "error",
            "code": "L301",
            "message": "there is no variable 'x' here",
            "hint": "declare it first: int x;",
        },
        {
            "file": str(deployment),
            "range": {"start": {"line": 1, "column": 7}, "end": {"line": 1, "column": 14}},
            "severity": "error",
            "code": "L704",
            "message": "the id 'a\x1b[31mb' is not valid",
            "hint": "an id consists of letters, digits, '.', '_' and '-'",
        },
    ]


def test_valid_files_give_an_empty_array(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = tmp_path / "m.L"
    program.write_text("resource Arm { init(string[] arg) { } }\n")
    assert findings(capsys, program) == (0, [])


def test_a_warning_is_not_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = tmp_path / "m.L"
    program.write_text(PROGRAM.replace("x > 0", "f() > 0"))
    status, (found,) = findings(capsys, program)
    assert (status, found["severity"], found["code"]) == (0, "warning", "L901")


def test_findings_in_devices_files_have_a_range(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "m.L").write_text("resource Arm { init(string[] arg) { } }\n")
    (tmp_path / "m.dL").write_text("//Arm:arm@here\n")
    (tmp_path / "m.devices.yaml").write_text("agents:\n  arm:\n    heep: 3\n")
    status, (found,) = findings(capsys, tmp_path / "m.dL")
    assert (status, found["severity"]) == (65, "error")
    assert found["file"] == str(tmp_path / "m.devices.yaml")
    assert isinstance(found["range"], dict)
    assert found["range"]["start"]["line"] == 3


def test_control_characters_of_a_finding_are_escaped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deployment = tmp_path / "m.dL"
    deployment.write_text("//Arm:a\x1b[31mb@here\n")
    assert main(["check", str(deployment)]) == 65
    assert "\x1b" not in capsys.readouterr().err


def test_hosts_with_keys_are_the_inventory_of_a_team(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LFIELD_AUTHORITY", str(tmp_path / "authority"))
    (tmp_path / "m.L").write_text("resource Arm { init(string[] arg) { } }\n")
    deployment = tmp_path / "m.dL"
    deployment.write_text("//Arm:a@alpha\n//Arm:z@zulu\n")
    assert findings(capsys, deployment) == (0, [])
    assert [main(["keys", "init"]), main(["keys", "host", "alpha", "bravo"])] == [0, 0]
    capsys.readouterr()
    status, found = findings(capsys, deployment)
    assert (status, [each["code"] for each in found]) == (0, ["L908"])
    assert found[0]["hint"] == "hosts with keys: alpha and bravo"
    (tmp_path / "authority" / "authority.pem").write_text("damaged")
    assert findings(capsys, deployment) == (0, [])


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("//Arm:one@alpha", "ids of type Arm: one"),
        ("//Boss:two@alpha", "no agent of type Arm is deployed"),
        ("//Boss:elsewhere@alpha", "'elsewhere' is a Boss; no agent of type Arm is deployed"),
    ],
)
def test_an_unknown_agent_is_reported_with_the_agents_of_its_type(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str, hint: str
) -> None:
    (tmp_path / "m.L").write_text(
        "resource Arm { init(string[] arg) { } }\n"
        'coordinator Boss { init(string[] arg) { Arm arm = findArm("elsewhere"); arm.agent(); } }\n'
    )
    deployment = tmp_path / "m.dL"
    deployment.write_text(f"{line}\n//Boss:boss@alpha\n")
    status, found = findings(capsys, deployment)
    assert (status, [each["code"] for each in found], found[0]["hint"]) == (0, ["L907"], hint)


def test_a_yaml_file_is_checked_with_its_deployment(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "m.devices.yaml").write_text("agents: {}\n")
    assert main(["check", "--json", str(tmp_path / "m.devices.yaml")]) == 64
    assert json.loads(capsys.readouterr().out)["code"] == "usage"


def test_an_unusable_driver_is_named_where_a_type_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    package, metadata = tmp_path / "unit_of_fruit", tmp_path / "unit_of_fruit-1.0.dist-info"
    package.mkdir()
    metadata.mkdir()
    (package / "__init__.py").write_text(
        "from lfield.driver import Plugin\n"
        "PLUGIN = Plugin('pump', 'unit_of_fruit', 'unit_of_fruit:X', 'pump')\n"
    )
    (package / "manifest.yaml").write_text(
        "driver: pump\ntype: Pump\nmeaning: a pump\nsafe_states: [stop]\n"
        "telemetry: {level: {type: real, unit: banana, max_age: 1.0, meaning: level}}\n"
    )
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: unit-of-fruit\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[lfield.drivers.v1]\npump = unit_of_fruit:PLUGIN\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    program = tmp_path / "m.L"
    program.write_text("resource P {\n    Pump pump;\n    init(string[] arg) { }\n}\n")
    status, found = findings(capsys, program)
    assert status == 65
    assert [(finding["severity"], finding["code"]) for finding in found] == [
        ("error", "L302"),
        ("warning", "driver-broken"),
    ]
    assert "banana" in str(found[1]["message"])


def test_a_deployment_without_its_program_is_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "m.dL").write_text("//Arm:arm@here\n")
    status, found = findings(capsys, tmp_path / "m.dL")
    assert (status, [finding["code"] for finding in found]) == (0, ["no-program"])
