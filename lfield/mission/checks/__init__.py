"""Checks of a mission between its files: program, deployment, bindings, files that the program names."""
