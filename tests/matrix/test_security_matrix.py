"""Every cell of the security matrix, tried where a host decides of it: on its links, at its Unix socket, as
`lfield up` starts it, and in its machine. `planted_holes.py` tells whether cells notice what is not asked.

`pytest -s` prints how many are as the table says. A cell that is not yet as it should be fails too when that
changes: then the table has to say so.
"""

from __future__ import annotations

import pytest
from bundles_shown import Bundles
from key_folders import Folders
from network_callers import Network
from planted_holes import HOLES, ROOT, noticed
from portal_rules import Portals
from security_table import PAGE, Cell, cells, page, ways
from service_callers import Services
from socket_users import Users

from lfield.mission import bundle


@pytest.fixture(scope="module")
def network():
    return Network()


@pytest.fixture(scope="module")
def users():
    with Users() as made:
        yield made


@pytest.fixture(scope="module")
def bundles(tmp_path_factory):
    return Bundles(tmp_path_factory.mktemp("bundles"))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    return Folders(tmp_path_factory.mktemp("keys"))


@pytest.fixture(scope="module")
def portals(tmp_path_factory):
    return Portals(tmp_path_factory.mktemp("portals"))


#: The ways by name.
WAYS = {way.name: way for way in ways()}


def of(way):
    return [pytest.param(cell, id=cell.name) for cell in WAYS[way].cells()]


def is_as_told(cell: Cell, done: bool) -> None:
    """What happens today is what the mark says, also where that is not what should be."""
    assert done == (cell.done if cell.kept else not cell.done), (
        f"{cell.name}: {'done' if done else 'refused'}"
    )


@pytest.mark.few(120)
@pytest.mark.parametrize("cell", of("network"))
def test_over_the_network(network, cell):
    is_as_told(cell, network.tried(cell.who, cell.what))


@pytest.mark.few(40)
@pytest.mark.parametrize("cell", of("door"))
def test_at_the_door(network, users, cell):
    is_as_told(cell, network.tried_at_socket(users, cell.who, cell.what))


@pytest.mark.few(60)
@pytest.mark.parametrize("cell", of("service"))
def test_at_the_service_of_a_robot(network, cell):
    is_as_told(cell, Services(network).tried(cell.who, cell.what))


@pytest.mark.few(40)
@pytest.mark.parametrize("cell", of("standing"))
def test_on_a_link_that_stands(network, cell):
    is_as_told(cell, network.tried_on_a_link(cell.who, cell.what))


@pytest.mark.parametrize("cell", of("keys"))
def test_with_keys(folders, cell):
    is_as_told(cell, folders.tried(cell.who, cell.what))


@pytest.mark.parametrize("cell", of("portals"))
def test_from_a_coordinator(portals, cell):
    is_as_told(cell, portals.tried(cell.who, cell.what))


@pytest.mark.parametrize("who", WAYS["portals"].rows)
def test_a_resource_is_reserved_by_whom_it_serves(portals, who):
    cells = [cell for cell in WAYS["portals"].cells() if cell.who == who]
    for resource in {cell.what.partition(".")[0] for cell in cells}:
        served = any(cell.done for cell in cells if cell.what.startswith(f"{resource}."))
        assert portals.reserved(who, resource) == served


@pytest.mark.few(30)
@pytest.mark.parametrize("cell", of("bundle"))
def test_as_a_bundle(bundles, cell):
    is_as_told(cell, bundles.tried(cell.who, cell.what))


@pytest.mark.parametrize("part", bundle.PARTS)
def test_what_was_changed_would_be_run_if_it_were_signed(bundles, part):
    assert bundles.runs_if_signed(part)


def test_the_page_is_the_table():
    assert PAGE.read_text(encoding="utf-8") == page(), "python tests/matrix/page.py --write"


def test_there_are_cells_enough_and_ways_have_both_marks():
    every = cells()
    print(f"security matrix: {sum(cell.kept for cell in every)} of {len(every)} cells are as they should be")
    assert len(every) >= 200
    assert all({cell.done for cell in way.cells()} == {True, False} for way in ways())


@pytest.mark.parametrize("hole", HOLES, ids=lambda hole: hole.name)
def test_holes_can_still_be_planted(hole):
    text = (ROOT / "lfield" / hole.file).read_text(encoding="utf-8")
    assert text.count(hole.stands) == 1


@pytest.mark.few(0)
@pytest.mark.parametrize("hole", HOLES, ids=lambda hole: hole.name)
def test_a_planted_security_hole_is_found(hole):
    """In a copy of lfield that has the hole, a cell of the matrix fails."""
    assert noticed(hole) > 0
