"""What a host tells of its agents: asked, sampled, and written for others."""
