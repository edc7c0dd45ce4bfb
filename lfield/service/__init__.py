"""The permanent service of a robot: stores bundles, votes about their activation, runs the mission's host."""
