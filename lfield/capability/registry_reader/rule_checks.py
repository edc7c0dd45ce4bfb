"""Checks of rules: the calls of one-to-one rules, the names of all, and cycles through needs."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence

from lfield import units
from lfield.capability import realisations
from lfield.capability.model import Argument, Composition, Equivalence, Portal, PortalMap, Primitive
from lfield.capability.registry_reader import messages
from lfield.capability.registry_reader.registry_builder import RegistryBuilder
from lfield.capability.registry_reader.unit_signatures import argument_type, constant_type, fits
from lfield.text.source_text import Diagnostic, Span
from lfield.text.suggestions import listed

# --- calls ---------------------------------------------------------------------------------------------


def check_calls(builder: RegistryBuilder, rule: Equivalence, serves: Primitive, by: Primitive) -> None:
    """Report portals that `by` does not have, and arguments and results of other types.

    Both sides of a one-to-one rule are primitives, so all types are known.
    """
    missing = []
    for name, portal in serves.portals.items():
        served = rule.portals[name]
        target = by.portals.get(served.target)
        if target is not None:
            _check_arguments(builder, served, portal, target, f"{by.name}.{target.name}")
            _check_result(builder, served, serves.name, portal, target)
        elif served.span is rule.span:
            missing.append(name)
        else:
            builder.report_unknown_portal(by, served.target, served.span)
    if missing:
        builder.report(
            messages.MISSING_PORTAL, rule.span, portals=listed(missing), serves=serves.name, by=by.name
        )


def _check_result(
    builder: RegistryBuilder, served: PortalMap, primitive: str, portal: Portal, target: Portal
) -> None:
    """Report a portal whose result for the caller is not that of the canonical one, in its unit."""
    if portal.result == "void":
        return
    result_given, result = result_type(served.result, portal, target.result), served.result
    if not fits(result_given, portal.result):
        builder.found.add(wrong_result(served.span, primitive, portal, result_given))
    elif result is None or (not result.parameter and result.constant is None):
        subject = f"what {primitive}.{portal.name} emits"
        _check_unit(builder, served.span, result or Argument(), target.unit, portal.unit, subject)


def wrong_result(span: Span, primitive: str, portal: Portal, type_given: str) -> Diagnostic:
    """The finding that a portal returns another result than the canonical one emits."""
    return messages.WRONG_RESULT.at(
        span,
        primitive=primitive,
        portal=portal.name,
        expected=portal.result,
        given="nothing" if type_given == "void" else type_given,
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
    builder: RegistryBuilder, served: PortalMap, portal: Portal, target: Portal, target_text: str
) -> None:
    if len(served.arguments) != len(target.parameters):
        builder.report(
            messages.WRONG_COUNT,
            served.span,
            target=target_text,
            expected=len(target.parameters),
            given=len(served.arguments),
            parameters=listed((f"{p.type} {p.name}" for p in target.parameters), "nothing"),
        )
        return
    for number, (argument, parameter) in enumerate(zip(served.arguments, target.parameters, strict=True), 1):
        type_given = argument_type(argument, portal)
        _check_argument(builder, served.span, type_given, parameter.type, number, target_text)
        own = [p.unit for p in portal.parameters if p.name == argument.parameter]
        if own and fits(type_given, parameter.type):
            subject = f"argument {number} of {target_text}"
            _check_unit(builder, served.span, argument, own[0], parameter.unit, subject)


def _check_argument(
    builder: RegistryBuilder, span: Span, type_given: str, expected: str, number: int, target: str
) -> None:
    if not fits(type_given, expected):
        builder.report(
            messages.WRONG_ARGUMENT, span, number=number, target=target, expected=expected, given=type_given
        )


def _check_unit(
    builder: RegistryBuilder, span: Span, argument: Argument, unit: str, expected: str, subject: str
) -> None:
    """Report a number in `unit` that is passed, converted or not, where another unit is required."""
    if units.conversion(unit, expected) != (argument.factor, argument.offset):
        builder.report(messages.WRONG_UNIT, span, what=subject, expected=expected or "1", given=unit or "1")


# --- names ---------------------------------------------------------------------------------------------


def check_ways(builder: RegistryBuilder) -> None:
    """Report rules and needs whose names differ in the registry and not in L: one field for two."""
    first_users: dict[tuple[str, str], str] = {}
    for primitive, field, name, span in _class_fields(builder):
        other = first_users.setdefault((primitive, field), name)
        if other != name:
            builder.report(messages.SAME_WAY, span, name=name, other=other, way=field, primitive=primitive)


def _class_fields(builder: RegistryBuilder) -> Iterator[tuple[str, str, str, Span]]:
    """Primitive, field, the name from which it is derived, and the place of that name."""
    for equivalence in builder.equivalences.values():
        yield (
            equivalence.serves,
            realisations.equivalent(equivalence.name),
            equivalence.name,
            equivalence.span,
        )
    for rule in builder.compositions.values():
        yield rule.serves, realisations.composed(rule.name), rule.name, rule.span
        for need in rule.needs.values():
            name = f"{rule.name}.{need.name}"
            yield rule.serves, realisations.part(rule.name, need.name), name, need.span


# --- circles -------------------------------------------------------------------------------------------

#: The primitives that serve each primitive, with the rules.
Graph = Mapping[str, Sequence[tuple[str, str]]]


def check_cycles(builder: RegistryBuilder) -> None:
    """Report every cycle through a need, with its path.

    Rules are edges from the served primitive to the serving one. One-to-one rules may be cyclic, since each
    search runs once. A need may be the served primitive itself: two haul more than one. No other cycle may
    contain a need, because compositions would be unbounded.
    """
    graph = _graph(builder)
    for rule in builder.compositions.values():
        for need in rule.needs.values():
            back = _path(graph, need.primitive, rule.serves)
            if back:
                steps = [
                    rule.serves,
                    f"{need.primitive} ({rule.name})",
                    *(f"{primitive} ({by})" for primitive, by in back),
                ]
                place = _blamed_span(builder, need.span, [by for _, by in back])
                builder.report(messages.CYCLE, place, path=" -> ".join(steps))


def _blamed_span(builder: RegistryBuilder, need: Span, rules: Sequence[str]) -> Span:
    """The place where a cycle was closed: at a rule of the mission, if it leads through a shipped one."""
    mission = {str(file.path) for file in builder.files if file.mission}
    known: Mapping[str, Equivalence | Composition] = {**builder.equivalences, **builder.compositions}
    spans = [need, *(known[rule].span for rule in rules)]
    return next((span for span in spans if span.source.name in mission), need)


def _graph(builder: RegistryBuilder) -> Graph:
    graph: dict[str, list[tuple[str, str]]] = {name: [] for name in builder.primitives}
    for equivalence in builder.equivalences.values():
        graph[equivalence.serves].append((equivalence.by, equivalence.name))
    for composition in builder.compositions.values():
        needs = composition.needs.values()
        graph[composition.serves].extend((need.primitive, composition.name) for need in needs)
    return graph


def _path(graph: Graph, start: str, goal: str) -> list[tuple[str, str]] | None:
    """A shortest path between two primitives, as steps with their rules; None if there is none."""
    predecessors: dict[str, tuple[str, str]] = {start: ("", "")}
    waiting = deque([start])
    while waiting and goal not in predecessors:
        node = waiting.popleft()
        for primitive, rule in graph[node]:
            if primitive not in predecessors:
                predecessors[primitive] = (node, rule)
                waiting.append(primitive)
    if goal not in predecessors:
        return None
    steps: list[tuple[str, str]] = []
    while goal != start:
        before, rule = predecessors[goal]
        steps.append((goal, rule))
        goal = before
    return steps[::-1]
