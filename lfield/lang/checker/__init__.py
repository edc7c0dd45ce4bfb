"""Raw syntax tree to checked tree: names, types, overloads and the scope rules of L."""

from lfield.lang.checker.program import check

__all__ = ["check"]
