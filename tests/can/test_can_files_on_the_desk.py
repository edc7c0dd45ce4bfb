"""Findings of `lfield check` and `lfield build` in the DBC and EDS files that bindings name."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lfield import exit_status
from lfield.cli.main import main

PROGRAM = """resource Pump { CanSignals pump; CanAxis hoist; init(string[] arg) { } }
"""
BINDINGS = """
      pump: {driver: can, endpoint: "socketcan:can0", dbc: pump.dbc, waivers: [no_confirmation]}
      hoist:
        {driver: can, endpoint: "socketcan:can0", protocol: cia402, node: 5, counts: 4096, eds: hoist.eds}
"""
DEVICES = f"agents:\n  p:\n    devices:{BINDINGS}"
DBC = 'VERSION ""\n\nBO_ 256 Command: 8 Host\n SG_ speed : 0|16@1- (0.1,0) [0|0] "" Pump\n'
EDS = "[1000]\nParameterName=Device type\nObjectType=0x7\nDataType=0x0007\nAccessType=ro\nPDOMapping=0\n"


def mission(folder: Path, dbc: str, eds: str) -> Path:
    (folder / "m.L").write_text(PROGRAM)
    (folder / "m.dL").write_text("//Pump:p@alpha\n")
    (folder / "m.devices.yaml").write_text(DEVICES)
    (folder / "pump.dbc").write_text(dbc)
    (folder / "hoist.eds").write_text(eds)
    return folder / "m.dL"


def findings(deploy: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[tuple[str, int, str]]]:
    status = main(["check", "--json", str(deploy)])
    found = json.loads(capsys.readouterr().out)
    errors = [one for one in found if one["severity"] == "error"]
    return status, [(Path(one["file"]).name, one["range"]["start"]["line"], one["code"]) for one in errors]


def test_valid_files_pass_check_and_build(tmp_path, capsys):
    deploy = mission(tmp_path, DBC, EDS)
    assert findings(deploy, capsys) == (exit_status.DONE, [])
    assert main(["build", str(deploy), "-o", str(tmp_path / "m.lfm")]) == exit_status.DONE


def test_all_file_errors_are_reported_with_their_places(tmp_path, capsys):
    wrong = DBC + ' SG_ valve : 16|8@1+ (1,5,0) [0|100] "%" Pump\nBO_ 257 Status 8 Pump\n'
    deploy = mission(tmp_path, wrong, "[FileInfo]\nFileName=hoist.eds\n")
    places = [("hoist.eds", 1, "EDS901"), ("pump.dbc", 5, "DBC102"), ("pump.dbc", 6, "DBC102")]
    status, found = findings(deploy, capsys)
    assert status == exit_status.DATA
    assert [(file, line) for file, line, _ in sorted(found)] == [(file, line) for file, line, _ in places]
    assert main(["build", str(deploy), "-o", str(tmp_path / "m.lfm")]) == exit_status.DATA
    output = capsys.readouterr().err
    assert f"{tmp_path / 'pump.dbc'}:5:" in output
    assert not (tmp_path / "m.lfm").exists()


def test_unreadable_or_missing_file_is_reported(tmp_path, capsys):
    deploy = mission(tmp_path, DBC, EDS)
    (tmp_path / "pump.dbc").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    status, found = findings(deploy, capsys)
    assert status == exit_status.DATA
    assert {file for file, _, _ in found} <= {"pump.dbc", "m.devices.yaml"}
    # A missing file is another error.
    (tmp_path / "pump.dbc").unlink()
    assert findings(deploy, capsys) == (exit_status.DATA, [("m.devices.yaml", 4, "Y113")])


def test_file_of_two_bindings_is_reported_once(tmp_path, capsys):
    deploy = mission(tmp_path, DBC.replace("(0.1,0)", "(0.1;0)"), EDS)
    (tmp_path / "m.dL").write_text("//Pump:p@alpha\n//Pump:q@alpha\n")
    other = f"  q:\n    devices:{BINDINGS.replace('node: 5', 'node: 6')}"
    (tmp_path / "m.devices.yaml").write_text(DEVICES + other)
    status, found = findings(deploy, capsys)
    assert (status, [(file, line) for file, line, _ in found]) == (exit_status.DATA, [("pump.dbc", 4)])
