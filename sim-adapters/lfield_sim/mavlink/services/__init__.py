"""MAVLink microservices: parameters, plans (missions, fences, rally points), files."""
