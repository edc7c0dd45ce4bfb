"""Every cell of the security matrix, tested where a host decides: on its links, at its Unix socket, at the
start by `lfield up`, and in its machine. `planted_holes.py` checks that cells detect missing checks.

`pytest -s` prints the number of cells without deviation. A cell with a known deviation also fails when the
deviation disappears: then the table must be updated.
"""

from __future__ import annotations

import pytest
from assistant_callers import Assistants
from key_folders import Folders
from network_callers import Network
from planted_holes import HOLES, ROOT, noticed
from portal_rules import Portals
from security_table import PAGE, Cell, cells, page, ways
from service_callers import Services
from signed_bundles import Bundles
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


@pytest.fixture(scope="module")
def assistants(tmp_path_factory):
    return Assistants(tmp_path_factory.mktemp("assistants"))


#: The access paths by name.
WAYS = {way.name: way for way in ways()}


def of(way):
    return [pytest.param(cell, id=cell.name) for cell in WAYS[way].cells()]


def assert_as_marked(cell: Cell, done: bool) -> None:
    """The current behaviour equals the mark, also for a known deviation from the intention."""
    assert done == (cell.done if cell.kept else not cell.done), (
        f"{cell.name}: {'done' if done else 'refused'}"
    )


@pytest.mark.few(60)
@pytest.mark.parametrize("cell", of("network"))
def test_access_over_the_network(network, cell):
    assert_as_marked(cell, network.tried(cell.who, cell.what))


@pytest.mark.few(40)
@pytest.mark.parametrize("cell", of("door"))
def test_access_at_the_door(network, users, cell):
    assert_as_marked(cell, network.tried_at_socket(users, cell.who, cell.what))


@pytest.mark.few(30)
@pytest.mark.parametrize("cell", of("service"))
def test_access_at_the_service_of_a_robot(network, cell):
    assert_as_marked(cell, Services(network).tried(cell.who, cell.what))


@pytest.mark.few(40)
@pytest.mark.parametrize("cell", of("standing"))
def test_access_on_a_link_that_is_open(network, cell):
    assert_as_marked(cell, network.tried_on_a_link(cell.who, cell.what))


@pytest.mark.parametrize("cell", of("keys"))
def test_start_with_keys(folders, cell):
    assert_as_marked(cell, folders.tried(cell.who, cell.what))


@pytest.mark.parametrize("cell", of("portals"))
def test_portal_call_from_a_coordinator(portals, cell):
    assert_as_marked(cell, portals.tried(cell.who, cell.what))


@pytest.mark.parametrize("who", WAYS["portals"].rows)
def test_resource_is_reserved_by_a_coordinator_that_may_call_it(portals, who):
    cells = [cell for cell in WAYS["portals"].cells() if cell.who == who]
    for resource in {cell.what.partition(".")[0] for cell in cells}:
        served = any(cell.done for cell in cells if cell.what.startswith(f"{resource}."))
        assert portals.reserved(who, resource) == served


@pytest.mark.parametrize("cell", of("assistants"))
def test_action_of_an_assistant(assistants, cell):
    assert_as_marked(cell, assistants.tried(cell.who, cell.what))


@pytest.mark.few(30)
@pytest.mark.parametrize("cell", of("bundle"))
def test_start_as_a_bundle(bundles, cell):
    assert_as_marked(cell, bundles.tried(cell.who, cell.what))


@pytest.mark.parametrize("part", bundle.PARTS)
def test_changed_part_is_run_when_signed(bundles, part):
    assert bundles.runs_if_signed(part)


def test_matrix_page_equals_the_table():
    assert PAGE.read_text(encoding="utf-8") == page(), "python tests/matrix/page.py --write"


def test_matrix_has_enough_cells_and_both_marks_per_path():
    every = cells()
    print(f"security matrix: {sum(cell.kept for cell in every)} of {len(every)} cells are as they should be")
    assert len(every) >= 200
    assert all({cell.done for cell in way.cells()} == {True, False} for way in ways())


@pytest.mark.parametrize("hole", HOLES, ids=lambda hole: hole.name)
def test_planted_holes_match_the_code(hole):
    text = (ROOT / "lfield" / hole.file).read_text(encoding="utf-8")
    assert text.count(hole.stands) == 1


@pytest.mark.few(0)
@pytest.mark.parametrize("hole", HOLES, ids=lambda hole: hole.name)
def test_a_planted_security_hole_is_found(hole):
    """A copy of lfield with the hole makes a cell of the matrix fail."""
    assert noticed(hole) > 0
