"""Checks of rules: the calls of one-to-one rules, the names of all, and cycles through needs."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence

from lfield import units
from lfield.capability import ways
from lfield.capability.model import Argument, Composition, Equivalence, Portal, PortalMap, Primitive
from lfield.capability.registry_reader import messages
from lfield.capability.registry_reader.registry_builder import RegistryBuilder
from lfield.capability.registry_reader.unit_signatures import argument_type, constant_type, fits
from lfield.text.source_text import Diagnostic, Span
from lfield.text.suggestions import listed

# --- calls ---------------------------------------------------------------------------------------------


def check_calls(draft: RegistryBuilder, rule: Equivalence, serves: Primitive, by: Primitive) -> None:
    """Report portals that `by` does not have, and arguments and results of other types.

    Both sides of a one-to-one rule are primitives, so all types are known.
    """
    missing = []
    for name, portal in serves.portals.items():
        served = rule.portals[name]
        target = by.portals.get(served.target)
        if target is not None:
            _check_arguments(draft, served, portal, target, f"{by.name}.{target.name}")
            _check_result(draft, served, serves.name, portal, target)
        elif served.span is rule.span:
            missing.append(name)
        else:
            draft.report_unknown_portal(by, served.target, served.span)
    if missing:
        draft.report(
            messages.MISSING_PORTAL, rule.span, portals=listed(missing), serves=serves.name, by=by.name
        )


def _check_result(
    draft: RegistryBuilder, served: PortalMap, primitive: str, portal: Portal, target: Portal
) -> None:
    """Report a portal whose result for the caller is not that of the canonical one, in its unit."""
    if portal.result == "void":
        return
    given, result = result_type(served.result, portal, target.result), served.result
    if not fits(given, portal.result):
        draft.found.add(wrong_result(served.span, primitive, portal, given))
    elif result is None or (not result.parameter and result.constant is None):
        what = f"what {primitive}.{portal.name} emits"
        _check_unit(draft, served.span, result or Argument(), target.unit, portal.unit, what)


def wrong_result(span: Span, primitive: str, portal: Portal, given: str) -> Diagnostic:
    """The finding that a portal returns another result than the canonical one emits."""
    return messages.WRONG_RESULT.at(
        span,
        primitive=primitive,
        portal=portal.name,
        expected=portal.result,
        given="nothing" if given == "void" else given,
    )


def result_type(result: Argument | None, portal: Portal, emitted: str) -> str:
    """The L type of the result for the caller, when the target emits `emitted`; '?' when that is not
    known.
    """
    if result is None:
        return emitted
    if result.parameter:
        return argument_type(result, portal)
    if result.constant is not None:
        return constant_type(result.constant)
    return "real" if emitted == "int" else emitted


def _check_arguments(
    draft: RegistryBuilder, served: PortalMap, portal: Portal, target: Portal, shown: str
) -> None:
    if len(served.arguments) != len(target.parameters):
        draft.report(
            messages.WRONG_COUNT,
            served.span,
            target=shown,
            expected=len(target.parameters),
            given=len(served.arguments),
            parameters=listed((f"{p.type} {p.name}" for p in target.parameters), "nothing"),
        )
        return
    for number, (argument, parameter) in enumerate(zip(served.arguments, target.parameters, strict=True), 1):
        given = argument_type(argument, portal)
        _check_argument(draft, served.span, given, parameter.type, number, shown)
        own = [p.unit for p in portal.parameters if p.name == argument.parameter]
        if own and fits(given, parameter.type):
            what = f"argument {number} of {shown}"
            _check_unit(draft, served.span, argument, own[0], parameter.unit, what)


def _check_argument(
    draft: RegistryBuilder, span: Span, given: str, expected: str, number: int, target: str
) -> None:
    if not fits(given, expected):
        draft.report(
            messages.WRONG_ARGUMENT, span, number=number, target=target, expected=expected, given=given
        )


def _check_unit(
    draft: RegistryBuilder, span: Span, given: Argument, unit: str, expected: str, what: str
) -> None:
    """Report a number in `unit` that is passed, converted or not, where another unit is required."""
    if units.conversion(unit, expected) != (given.factor, given.offset):
        draft.report(messages.WRONG_UNIT, span, what=what, expected=expected or "1", given=unit or "1")


# --- names ---------------------------------------------------------------------------------------------


def check_ways(draft: RegistryBuilder) -> None:
    """Report rules and needs whose names differ in the registry and not in L: one field for two."""
    first_users: dict[tuple[str, str], str] = {}
    for primitive, way, name, span in _ways(draft):
        other = first_users.setdefault((primitive, way), name)
        if other != name:
            draft.report(messages.SAME_WAY, span, name=name, other=other, way=way, primitive=primitive)


def _ways(draft: RegistryBuilder) -> Iterator[tuple[str, str, str, Span]]:
    """Primitive, field, the name from which it is derived, and the place of that name."""
    for equivalence in draft.equivalences.values():
        yield equivalence.serves, ways.equivalent(equivalence.name), equivalence.name, equivalence.span
    for rule in draft.compositions.values():
        yield rule.serves, ways.composed(rule.name), rule.name, rule.span
        for need in rule.needs.values():
            name = f"{rule.name}.{need.name}"
            yield rule.serves, ways.part(rule.name, need.name), name, need.span


# --- circles -------------------------------------------------------------------------------------------

#: The primitives that serve each primitive, with the rules.
Graph = Mapping[str, Sequence[tuple[str, str]]]


def check_cycles(draft: RegistryBuilder) -> None:
    """Report every cycle through a need, with its path.

    Rules are edges from the served primitive to the serving one. One-to-one rules may be cyclic, since each
    search runs once. A need may be the served primitive itself: two haul more than one. No other cycle may
    contain a need, because compositions would be unbounded.
    """
    graph = _graph(draft)
    for rule in draft.compositions.values():
        for need in rule.needs.values():
            back = _path(graph, need.primitive, rule.serves)
            if back:
                steps = [rule.serves, f"{need.primitive} ({rule.name})", *(f"{to} ({by})" for to, by in back)]
                place = _blamed_span(draft, need.span, [by for _, by in back])
                draft.report(messages.CYCLE, place, path=" -> ".join(steps))


def _blamed_span(draft: RegistryBuilder, need: Span, rules: Sequence[str]) -> Span:
    """The place where a cycle was closed: at a rule of the mission, if it leads through a shipped one."""
    mission = {str(file.path) for file in draft.files if file.mission}
    known: Mapping[str, Equivalence | Composition] = {**draft.equivalences, **draft.compositions}
    spans = [need, *(known[rule].span for rule in rules)]
    return next((span for span in spans if span.source.name in mission), need)


def _graph(draft: RegistryBuilder) -> Graph:
    graph: dict[str, list[tuple[str, str]]] = {name: [] for name in draft.primitives}
    for equivalence in draft.equivalences.values():
        graph[equivalence.serves].append((equivalence.by, equivalence.name))
    for composition in draft.compositions.values():
        needs = composition.needs.values()
        graph[composition.serves].extend((need.primitive, composition.name) for need in needs)
    return graph


def _path(graph: Graph, start: str, goal: str) -> list[tuple[str, str]] | None:
    """A shortest path between two primitives, as steps with their rules; None if there is none."""
    predecessors: dict[str, tuple[str, str]] = {start: ("", "")}
    waiting = deque([start])
    while waiting and goal not in predecessors:
        node = waiting.popleft()
        for to, rule in graph[node]:
            if to not in predecessors:
                predecessors[to] = (node, rule)
                waiting.append(to)
    if goal not in predecessors:
        return None
    steps: list[tuple[str, str]] = []
    while goal != start:
        before, rule = predecessors[goal]
        steps.append((goal, rule))
        goal = before
    return steps[::-1]
