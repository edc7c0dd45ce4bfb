"""Installation of lfield on the robots of an inventory, over the system's ssh.

`plan` determines the steps for a robot, from its facts (`robot_facts`) and its required
installation (`installation`). `host_provisioning` executes them through an `SshConnection`. `wheel_cache`
collects the wheels for the robots on the desk, so that they need no internet access.
"""
