"""One host as a process: how it is run, what ends it, and when its mission is done."""
