"""Analyses of `together` for the first pass: calls that can start asynchronously, and the statements
before which they start.
"""
