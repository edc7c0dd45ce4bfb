"""The guard: a process that owns one bus and makes its devices safe. `core` decides, `shell` does the I/O."""
