"""Teams of services on simulated computers: desks push bundles, and a judge checks the services."""
