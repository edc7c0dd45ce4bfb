"""Every cell of the security matrix, tried against the links, doors and bundles that hosts have.

`pytest -s` prints how many are as the table says. A cell that is not yet as it should be fails too when that
changes: then the table has to say so.
"""

from __future__ import annotations

import pytest
from bundles_shown import Bundles
from callers import Network
from key_folders import Folders
from portal_rules import Portals
from security_table import PAGE, Cell, cells, page, ways


@pytest.fixture(scope="module")
def network():
    return Network()


@pytest.fixture(scope="module")
def bundles(tmp_path_factory):
    return Bundles(tmp_path_factory.mktemp("bundles"))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    return Folders(tmp_path_factory.mktemp("keys"))


@pytest.fixture(scope="module")
def portals(tmp_path_factory):
    return Portals(tmp_path_factory.mktemp("portals"))


def of(way):
    return [pytest.param(cell, id=cell.name) for cell in cells() if cell.way == way]


def is_as_told(cell: Cell, done: bool) -> None:
    """What happens today is what the mark says, also where that is not what should be."""
    assert done == (cell.done if cell.kept else not cell.done), (
        f"{cell.name}: {'done' if done else 'refused'}"
    )


@pytest.mark.parametrize("cell", of("network"))
def test_over_the_network(network, cell):
    is_as_told(cell, network.tried(cell.who, cell.what))


@pytest.mark.parametrize("cell", of("door"))
def test_at_the_door(network, cell, monkeypatch, tmp_path):
    is_as_told(cell, network.tried_at_the_door(cell.who, cell.what, monkeypatch, tmp_path))


@pytest.mark.parametrize("cell", of("standing"))
def test_on_a_link_that_stands(network, cell):
    is_as_told(cell, network.tried_on_a_link(cell.who, cell.what))


@pytest.mark.parametrize("cell", of("keys"))
def test_with_keys(folders, cell):
    is_as_told(cell, folders.tried(cell.who, cell.what))


@pytest.mark.parametrize("cell", of("portals"))
def test_from_a_coordinator(portals, cell):
    is_as_told(cell, portals.tried(cell.who, cell.what))


@pytest.mark.parametrize("cell", of("bundle"))
def test_as_a_bundle(bundles, cell):
    is_as_told(cell, bundles.tried(cell.who, cell.what))


def test_the_page_is_the_table():
    assert PAGE.read_text(encoding="utf-8") == page(), "python tests/matrix/page.py --write"


def test_there_are_cells_enough_and_ways_have_both_marks():
    every = cells()
    print(f"security matrix: {sum(cell.kept for cell in every)} of {len(every)} cells are as they should be")
    assert len(every) >= 200
    assert all({cell.done for cell in way.cells()} == {True, False} for way in ways())
