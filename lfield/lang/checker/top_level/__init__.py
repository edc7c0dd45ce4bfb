"""The declarations of a program beside its units: constants, enums, functions."""
