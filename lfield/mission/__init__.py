"""From files to a mission: program, team, registry and bindings that fit one another."""
