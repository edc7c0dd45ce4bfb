"""Turns of threads: their queue, and the limit of one run."""
