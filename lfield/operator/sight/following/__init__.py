"""How the streams of hosts are followed over cuts and restarts."""
