"""Whether the calls of a one-to-one rule fit: both sides are primitives, so all types are known."""

from __future__ import annotations

from lfield.capability.model import Argument, Equivalence, Portal, PortalMap, Primitive
from lfield.capability.reading import messages
from lfield.capability.reading.draft import Draft
from lfield.capability.reading.signatures import argument_type, constant_type, fits
from lfield.text.source import Diagnostic, Span
from lfield.text.suggest import listed


def check_calls(draft: Draft, rule: Equivalence, serves: Primitive, by: Primitive) -> None:
    """Report portals that `by` does not have, and arguments and results of other types."""
    missing = []
    for name, portal in serves.portals.items():
        served = rule.portals[name]
        target = by.portals.get(served.target)
        if target is not None:
            _check_arguments(draft, served, portal, target, f"{by.name}.{target.name}")
            _check_result(draft, served, serves.name, portal, target.result)
        elif served.span is rule.span:
            missing.append(name)
        else:
            draft.no_portal(by, served.target, served.span)
    if missing:
        draft.tell(
            messages.MISSING_PORTAL, rule.span, portals=listed(missing), serves=serves.name, by=by.name
        )


def _check_result(draft: Draft, served: PortalMap, primitive: str, portal: Portal, emitted: str) -> None:
    """Report a portal that would not give the caller what the canonical one emits."""
    given = result_type(served.result, portal, emitted)
    if portal.result != "void" and not fits(given, portal.result):
        draft.found.add(wrong_result(served.span, primitive, portal, given))


def wrong_result(span: Span, primitive: str, portal: Portal, given: str) -> Diagnostic:
    """The finding that a portal gives something else than the canonical one emits."""
    return messages.WRONG_RESULT.at(
        span,
        primitive=primitive,
        portal=portal.name,
        wanted=portal.result,
        given="nothing" if given == "void" else given,
    )


def result_type(result: Argument | None, portal: Portal, emitted: str) -> str:
    """The L type of what the caller gets, when the target emits `emitted`; '?' when that is not known."""
    if result is None:
        return emitted
    if result.parameter:
        return argument_type(result, portal)
    if result.constant is not None:
        return constant_type(result.constant)
    return "real" if emitted == "int" else emitted


def _check_arguments(draft: Draft, served: PortalMap, portal: Portal, target: Portal, shown: str) -> None:
    wanted = [p.type for p in target.parameters]
    if len(served.arguments) != len(wanted):
        draft.tell(
            messages.WRONG_COUNT,
            served.span,
            target=shown,
            wanted=len(wanted),
            given=len(served.arguments),
            parameters=listed((f"{p.type} {p.name}" for p in target.parameters), "nothing"),
        )
        return
    for number, (argument, type) in enumerate(zip(served.arguments, wanted, strict=True), 1):
        _check_argument(draft, served.span, argument_type(argument, portal), type, number, shown)


def _check_argument(draft: Draft, span: Span, given: str, wanted: str, number: int, target: str) -> None:
    if not fits(given, wanted):
        draft.tell(messages.WRONG_ARGUMENT, span, number=number, target=target, wanted=wanted, given=given)
