"""What a program declares beside its units: constants, enums, functions."""
