"""Golden programs: each has exactly the expected diagnostics, and every message of the table occurs."""

from pathlib import Path

import pytest
from lang_expectations import CAPABILITIES, GOLDEN, ROVER, THESIS, assert_exactly, expected

from lfield.errors import ProgramError
from lfield.lang.checker.argument_check import argument_findings
from lfield.lang.deployment import parse_deployment, read_deployment
from lfield.lang.frontend import check_file
from lfield.lang.messages import TABLE
from lfield.lang.tree import UnitKind

DEVICES = {"Rover": ROVER}
UNITS: dict[str, UnitKind] = {"Arm": "resource", "Boss": "coordinator", "Box": "class"}

PROGRAMS = sorted((GOLDEN / "errors").glob("*.L"))
DEPLOYMENTS = sorted((GOLDEN / "deployments" / "errors").glob("*.dL"))
MISSIONS = sorted((GOLDEN / "missions").glob("*.dL"))


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda p: p.stem)
def test_program_has_exactly_the_expected_diagnostics(path: Path) -> None:
    checked = check_file(path, devices=DEVICES, capabilities=CAPABILITIES)
    assert_exactly(path, checked.diagnostics)
    assert (checked.program is None) == any(severity == "error" for _, severity, _, _ in expected(path))


@pytest.mark.parametrize("path", DEPLOYMENTS, ids=lambda p: p.stem)
def test_deployment_has_exactly_the_expected_diagnostics(path: Path) -> None:
    units = {} if path.stem.startswith("L713") else UNITS
    with pytest.raises(ProgramError) as caught:
        read_deployment(path, units)
    assert_exactly(path, list(caught.value.diagnostics))


@pytest.mark.parametrize("path", MISSIONS, ids=lambda p: p.stem)
def test_deployment_and_program_have_exactly_the_expected_diagnostics(path: Path) -> None:
    program = check_file(path.with_suffix(".L")).program
    assert program is not None
    found = argument_findings(program.units, read_deployment(path, None))
    for file in (path, path.with_suffix(".L")):
        assert_exactly(
            file, [finding for finding in found if Path(finding.span.source.name).suffix == file.suffix]
        )


def test_every_code_has_a_golden_file_named_after_it() -> None:
    tested = {path.stem[:4] for path in (*PROGRAMS, *DEPLOYMENTS, *MISSIONS)}
    assert tested == set(TABLE)
    for path in (*PROGRAMS, *DEPLOYMENTS, *MISSIONS):
        files = (path, path.with_suffix(".L")) if path in MISSIONS else (path,)
        assert path.stem[:4] in {code for file in files for _, _, code, _ in expected(file)}, path.name


@pytest.mark.parametrize("path", sorted((GOLDEN / "ok").glob("*.L")), ids=lambda p: p.stem)
def test_valid_program_has_no_diagnostics(path: Path) -> None:
    checked = check_file(path, devices=DEVICES, capabilities=CAPABILITIES)
    assert [d.render() for d in checked.diagnostics] == []
    assert checked.program is not None


def test_valid_deployment_has_no_diagnostics() -> None:
    path = GOLDEN / "deployments" / "ok" / "forms.dL"
    deployment, found = parse_deployment(path.read_text(encoding="utf-8"), path.name, UNITS)
    assert (deployment is not None, found) == (True, [])


@pytest.mark.parametrize("name", ["cs", "mt", "peer"])
def test_program_of_the_thesis_checks(name: str) -> None:
    path = THESIS / f"{name}.L"
    if not path.exists():
        pytest.skip("the programs of the thesis are not beside this checkout (../shared/thesis-programs)")
    program = check_file(path).or_raise()
    kinds = {unit.name: unit.kind for unit in program.units}
    assert read_deployment(path.with_suffix(".dL"), kinds).agents
