"""Planted bugs of constants, enums, functions and query parameters: a golden program must find each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest
from msgspec.structs import replace

from lfield.capability.condition_compiler import compile_query
from lfield.capability.model import Attribute, OfferQuery
from lfield.capability.parameter_units import UnitCheck
from lfield.capability.query_values import Bindable, bind
from lfield.host import offer_queries
from lfield.lang.checker.library import enum_members
from lfield.lang.checker.scope import BodyContext
from lfield.lang.checker.top_level import constant_values, purity
from lfield.lang.standard_library.instances import enum_text

Patch = pytest.MonkeyPatch
_ATTRIBUTES = {
    **{name: Attribute(name, "real", unit="m") for name in ("north", "east", "down")},
    "payload": Attribute("payload", "real", unit="kg"),
    "colour": Attribute("colour", "text"),
}


@dataclass(frozen=True)
class LanguageBug:
    """A bug: how it is planted, what is broken, and the golden program that finds it."""

    plant: Callable[[Patch], None]
    broken: str
    program: str

    @property
    def name(self) -> str:
        return self.plant.__name__


def query_values_are_inserted_as_text(patch: Patch) -> None:
    def paste(query: OfferQuery, values: list[Bindable]) -> OfferQuery:
        text = query.condition.text if query.condition is not None else ""
        for number, value in enumerate(values):
            for letter in "ntb":
                written = f'"{value}"' if isinstance(value, str) else str(value).lower()
                text = text.replace(f"${letter}{number}", written)
        bound = bind(query, values)
        return replace(bound, condition=compile_query(text, _ATTRIBUTES).condition) if text else bound

    patch.setattr(offer_queries, "bind", paste)


def units_of_parameters_are_ignored(patch: Patch) -> None:
    patch.setattr(UnitCheck, "_convert", lambda self, parameter, needed: needed)


def enum_member_returns_the_name_of_the_next_member(patch: Patch) -> None:
    patch.setattr(
        enum_members, "enum_text", lambda name, members: enum_text(name, [*members[1:], members[0]])
    )


def functions_resolve_methods_of_their_caller(patch: Patch) -> None:
    patch.setattr(BodyContext, "methods", lambda self, name: self.unit.overloads(name, "method"))


def constant_division_rounds_down(patch: Patch) -> None:
    patch.setattr(
        constant_values, "_whole", lambda op, left, right: left // right if op == "/" else left % right
    )


def aliasing_through_array_elements_is_not_tracked(patch: Patch) -> None:
    patch.setattr(purity._Changes, "_put", lambda self, target, values: None)


BUGS = (
    LanguageBug(
        query_values_are_inserted_as_text,
        "query values are inserted as text: a quote in a value changes the query",
        "capability_parameters",
    ),
    LanguageBug(
        units_of_parameters_are_ignored,
        "a parameter in grams is compared with kilograms",
        "capability_parameters",
    ),
    LanguageBug(
        enum_member_returns_the_name_of_the_next_member,
        "name() of a member returns the name of the next one",
        "top_level_enums",
    ),
    LanguageBug(
        functions_resolve_methods_of_their_caller,
        "a function calls a method of the unit that calls it, which has the name of another function",
        "top_level_functions",
    ),
    LanguageBug(
        constant_division_rounds_down,
        "constants divide towards minus infinity, and the machine towards zero",
        "top_level_constants",
    ),
    LanguageBug(
        aliasing_through_array_elements_is_not_tracked,
        "a function may change its argument through an array that contains the argument",
        "L438_argument",
    ),
)
