"""Differential fuzzing of the engines: random programs must give the same instructions and the same bytes."""
