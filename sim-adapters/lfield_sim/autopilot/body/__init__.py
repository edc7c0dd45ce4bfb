"""Goals of a vehicle's motion, mission curves, and the position estimate."""
