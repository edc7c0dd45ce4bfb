"""Access rules of a mission: the reader of its access file, and decisions by its rules."""
