"""Inspection of blocks: decoding, dumps, stack traces."""
