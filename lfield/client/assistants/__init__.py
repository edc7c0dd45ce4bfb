"""A team as tools for AI assistants, by the Model Context Protocol."""
