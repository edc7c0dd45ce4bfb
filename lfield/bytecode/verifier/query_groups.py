"""Verifies the groups of queries: find, offers, teams, and queries about proxies; the tests of groups."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from lfield.bytecode.program import INT, OBJECT, PROXY, STRING, VOID, Quad, TypeRecord
from lfield.bytecode.verifier.operands import MethodView

#: Tests whether a type index is valid for an argument or result of a head.
TypeTest = Callable[[MethodView, int], bool]


class GroupSignature(NamedTuple):
    """The arguments of a head, in the order of the pushes, and its result (None for nothing)."""

    parameters: list[TypeTest]
    result: TypeTest | None


def accepts(expected: int) -> TypeTest:
    """A test for values that fit a type."""
    return lambda view, index: view.types.fits(index, expected)


def result_test(result: int) -> TypeTest | None:
    """A test for places in which a result of a type may be stored; None for no result."""
    return None if result == VOID else lambda view, index: view.types.fits(result, index)


def proxy_of(resource: int) -> TypeTest:
    """A test for proxies of a resource."""
    return lambda view, index: view.types.record(index) == TypeRecord(PROXY, resource)


def _find(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_find(view, pc, quad)
    return GroupSignature([accepts(STRING)], proxy_of(quad.a))


def _findall(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_find(view, pc, quad)
    proxy = proxy_of(quad.a)

    def is_array_of_proxies(view: MethodView, index: int) -> bool:
        return view.types.is_created_array(index) and proxy(view, view.types.element(index))

    return GroupSignature([], is_array_of_proxies)


def _check_find(view: MethodView, pc: int, quad: Quad) -> None:
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators find resources")
    if view.core.classes[quad.a].kind != "resource":
        raise view.refused(pc, "only resources are found")


def _offers(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_query(view, pc, quad)
    offer = TypeRecord(OBJECT, quad.a)

    def is_array_of_offers(view: MethodView, index: int) -> bool:
        types = view.types
        return types.is_created_array(index) and types.record(types.element(index)) == offer

    return GroupSignature([accepts(STRING)], is_array_of_offers)


def _teams(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_query(view, pc, quad)
    offer = TypeRecord(OBJECT, quad.a)

    def is_array_of_teams(view: MethodView, index: int) -> bool:
        types = view.types
        if not (types.is_created_array(index) and types.is_created_array(team := types.element(index))):
            return False
        return types.record(types.element(team)) == offer

    return GroupSignature([accepts(STRING), accepts(INT)], is_array_of_teams)


def _explain(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_query(view, pc, quad)
    return GroupSignature([accepts(STRING)], accepts(STRING))


def _about(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators have proxies")
    return GroupSignature([lambda view, index: view.types.kind(index) == PROXY], accepts(STRING))


def _check_query(view: MethodView, pc: int, quad: Quad) -> None:
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators query capabilities")
    if not view.core.classes[quad.a].capability:
        raise view.refused(pc, "only capabilities have offers")


#: The signatures of the instructions that query the team.
QUERY_SIGNATURES: Mapping[str, Callable[[MethodView, int, Quad], GroupSignature]] = {
    "find": _find,
    "findall": _findall,
    "offers": _offers,
    "teams": _teams,
    "explain": _explain,
    "agent": _about,
    "host": _about,
}
