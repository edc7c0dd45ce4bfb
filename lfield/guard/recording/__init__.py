"""The flight recorder of a guard: its inputs and decisions in a ring of files, and their replay."""
