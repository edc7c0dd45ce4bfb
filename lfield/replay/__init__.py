"""Replays recordings on the real cores, and compares what they do with what was recorded."""
