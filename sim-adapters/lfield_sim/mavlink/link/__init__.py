"""Packets to messages and back, over a lossy radio link; signing."""
