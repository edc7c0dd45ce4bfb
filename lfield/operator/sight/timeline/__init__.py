"""One time line of what happened on many hosts, whose clocks differ. Pure (decision 67)."""
