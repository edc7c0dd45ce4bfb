"""The threads of loops: their statements, as if they were written in L."""
