"""Text to raw syntax tree: a recursive descent parser with error recovery."""

from lfield.lang.parser.file_parser import parse_file

__all__ = ["parse_file"]
