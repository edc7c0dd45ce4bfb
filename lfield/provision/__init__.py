"""Installation of lfield on the robots of an inventory, over the system's ssh.

`plan` decides which steps a robot needs, from its facts (`robot_facts`) and the installation that it shall
have (`installation`). `host_provisioning` executes them through an `SshConnection`. `wheel_cache` collects on
the desk what the robots need, so that they need no internet access.
"""
