"""Replays recordings on the real cores, and compares the results with the recordings."""
