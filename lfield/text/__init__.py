"""Text input and output: source files, findings, YAML with positions, log messages, terminal output."""
