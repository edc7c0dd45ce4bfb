"""Robots for tests of `lfield provision`: namespaces with a real sshd, real users and sudo."""
