"""The coordinators of one host: arrival, departure, recovery, leases, reservations, orphaned devices."""
