"""Public kits for tests: clocks, golden programs, conformance kits."""
