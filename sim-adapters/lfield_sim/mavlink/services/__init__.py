"""The protocols beside flight: parameters, plans (missions, fences, rally points), files."""
