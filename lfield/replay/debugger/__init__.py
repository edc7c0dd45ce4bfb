"""The time-travel debugger: positions in recordings, reached by deterministic re-execution."""
