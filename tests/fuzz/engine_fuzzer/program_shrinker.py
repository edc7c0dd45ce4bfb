"""Reduces a program with a difference as far as possible in a short time."""

from __future__ import annotations

from collections.abc import Callable

from engine_fuzzer.mutations import Edit
from engine_fuzzer.program_tree import PLAIN, ProgramPiece

#: Returns true if the remaining program still shows the difference.
Shows = Callable[[], bool]


class TryBudget:
    """A number of remaining tries."""

    def __init__(self, tries: int) -> None:
        self.tries = tries

    def use(self, shows: Shows) -> bool:
        """Use one try; returns false if none is left."""
        self.tries -= 1
        return self.tries >= 0 and shows()


def shrink(program: ProgramPiece, shows: Shows, tries: int = 400) -> None:
    """Remove unneeded parts of a program in place; the unchanged program must show the difference."""
    spare, before = TryBudget(tries), -1
    while spare.tries > 0 and before != (before := len(program.text())):
        _statements(program, shows, spare)
        _hoisted(program, shows, spare)
        _expressions(program, shows, spare)


def shrunk_edits(edits: list[Edit], shows: Callable[[list[Edit]], bool]) -> list[Edit]:
    """The changes that are needed for the difference."""
    remaining = list(edits)
    for edit in edits:
        fewer = [other for other in remaining if other is not edit]
        if shows(fewer):
            remaining = fewer
    return remaining


def _statements(program: ProgramPiece, shows: Shows, spare: TryBudget) -> None:
    """Remove statements: many at a time, then fewer."""
    for block in list(program.blocks()):
        size = len(block)
        while size:
            at = 0
            while at < len(block):
                removed = block[at : at + size]
                del block[at : at + size]
                if not spare.use(shows):
                    block[at:at] = removed
                    at += size
            size //= 2


def _hoisted(program: ProgramPiece, shows: Shows, spare: TryBudget) -> None:
    """Replace a loop, a branch or a try with one of its bodies, if the program still shows the difference."""
    for block in list(program.blocks()):
        for at in reversed(range(len(block))):
            old = block[at]
            for part in old.parts:
                if isinstance(part, list):
                    block[at : at + 1] = part
                    if spare.use(shows):
                        break
                    block[at : at + len(part)] = [old]


def _expressions(program: ProgramPiece, shows: Shows, spare: TryBudget) -> None:
    """Replace an expression by one of its parts, or by a constant."""
    for piece in list(program.pieces()):
        if not piece.kind or not any(isinstance(part, ProgramPiece) for part in piece.parts):
            continue
        old = piece.parts
        inner = [part for part in old if isinstance(part, ProgramPiece) and part.kind == piece.kind]
        choices: list[str | ProgramPiece] = [PLAIN[piece.kind], *inner]
        for smaller in choices:
            piece.parts = [smaller]
            if spare.use(shows):
                break
            piece.parts = old
