"""Tests of missions: what their portals were called with and gave, and doubles that answer from Python."""
