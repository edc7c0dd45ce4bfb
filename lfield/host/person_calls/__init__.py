"""Portal calls of persons to the resources of a host."""
