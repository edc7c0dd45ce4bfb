"""Text to raw syntax tree: a recursive descent parser that goes on after mistakes."""

from lfield.lang.parser.file import parse

__all__ = ["parse"]
