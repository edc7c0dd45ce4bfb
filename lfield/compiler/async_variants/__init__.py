"""Analyses of `together` for the first pass: which calls can start asynchronously, and before which
statements."""
