"""The process that keeps a bus safe: its core decides, the process around it does."""
