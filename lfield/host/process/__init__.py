"""One host as a process: options, shutdown, end of the mission."""
