"""MAVLink microservices: parameters, plans, files."""
