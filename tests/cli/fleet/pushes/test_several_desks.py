"""Several desks that send bundles to the same robots at the same time."""

from __future__ import annotations

import pytest
from robots import PADDING, TEAM, program, told

pytestmark = pytest.mark.process


@pytest.mark.few(0)
def test_uploads_of_several_operators_do_not_remove_each_other(lfield, here, robots) -> None:
    team = robots("alpha", "bravo")
    team.up()
    for number in range(4):
        # The bundles have no common pieces.
        lines = "".join(f'write("{number}{n:07d} {n**7 * (number + 1):030d}");\n' for n in range(800))
        lfield.mission(program().replace(PADDING, lines), TEAM, name=f"m{number}")
        here("build", f"m{number}.dL", "-o", f"m{number}.lfm", status=0)
    desks = [lfield.start("push", f"m{number}.lfm", "--stage", "--json") for number in range(4)]
    for desk in desks:
        desk.wait()
    assert [(desk.popen.returncode, told(desk)["outcome"]) for desk in desks] == [(0, "staged")] * 4
