"""From YAML to a checked registry: every mistake in every file at its place, in one run."""
