"""Conditions and values over attributes, in L's own syntax: `payload >= 2.0 && environment == aerial`."""

from __future__ import annotations

from dataclasses import dataclass

from lfield.lang import syntax


@dataclass(frozen=True, slots=True)
class Mistake:
    """What is wrong with a text, where: characters `start` to `end` of it."""

    start: int
    end: int
    message: str
    hint: str = ""


@dataclass(frozen=True, slots=True)
class Expression:
    """A text that was parsed and checked."""

    text: str
    tree: syntax.Expr
