"""Raw syntax tree to checked tree: names, types, overloads and the scope rules of L."""

from lfield.lang.checker.program_checker import check_program

__all__ = ["check_program"]
