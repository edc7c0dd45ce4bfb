"""A mission in a folder with other Python files, none of which is imported."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
include <mavlink/copter.L>;
coordinator Pilot {
    init(string[] arg) { print("battery: " + f2s(findCopter(arg[1]).battery())); }
}
"""


@pytest.mark.few(0)
def test_python_files_beside_a_mission_are_not_imported(here, lfield):
    """The rule holds for hosts, guards, fakes, compilers, and the build of the bundle."""
    deployment = lfield.mission(PROGRAM, "//Copter:lead@alpha\n//Pilot:pilot@alpha?lead\n")
    for module in ("random", "heapq", "ctypes", "wasmtime", "uvloop", "pymavlink"):
        lfield.write(
            f"{module}.py", "raise SystemExit(f'{__name__} was loaded from the folder of the mission')"
        )
    result = here("up", "--deploy", deployment, "--all", "--sim", "--until-done", status=0)
    assert "battery: " in "\n".join((*result.out, *result.err)), result
