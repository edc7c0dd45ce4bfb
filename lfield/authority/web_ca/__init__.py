"""Certificates for browsers: a separate root CA and the keys of web pages."""
