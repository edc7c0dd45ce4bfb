"""A program as a tree of text, from which parts can be removed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

#: Replacements of unneeded expressions by type.
PLAIN = {
    "int": "0",
    "real": "0.0",
    "boolean": "false",
    "string": '"a"',
    "Node": "null",
    "int[]": "null",
    "real[]": "null",
    "Node[]": "null",
    "string[]": "null",
    "Store": "st",
}


@dataclass(eq=False)
class ProgramPiece:
    """An expression of a type, or a statement (of kind ""): text, smaller pieces, blocks of statements."""

    kind: str
    parts: list[str | ProgramPiece | list[ProgramPiece]] = field(default_factory=list)

    def text(self) -> str:
        """The L text."""
        return "".join(_text(part) for part in self.parts)

    def pieces(self) -> Iterator[ProgramPiece]:
        """This piece and all inner pieces, outer ones first."""
        yield self
        for part in self.parts:
            for piece in part if isinstance(part, list) else [part]:
                if isinstance(piece, ProgramPiece):
                    yield from piece.pieces()

    def blocks(self) -> Iterator[list[ProgramPiece]]:
        """All inner blocks of statements, outer ones first."""
        for piece in self.pieces():
            for part in piece.parts:
                if isinstance(part, list):
                    yield part


def _text(part: str | ProgramPiece | list[ProgramPiece]) -> str:
    if isinstance(part, str):
        return part
    if isinstance(part, ProgramPiece):
        return part.text()
    return "\n".join(piece.text() for piece in part)


def written(kind: str, form: str, *pieces: ProgramPiece | list[ProgramPiece]) -> ProgramPiece:
    """A piece from a text with a `#` for each part."""
    parts: list[str | ProgramPiece | list[ProgramPiece]] = []
    texts = form.split("#")
    assert len(texts) == len(pieces) + 1, form
    for text, piece in zip(texts, [*pieces, ""], strict=True):
        parts += [text, piece] if piece != "" else [text]
    return ProgramPiece(kind, parts)
