"""Robots for trials of `lfield provision`: namespaces with a real sshd, real users and sudo."""
