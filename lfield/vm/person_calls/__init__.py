"""Portal calls of persons: values of L in Python, and calls without a coordinator."""
