"""Operator side: status requests, orders, queries, dashboard, diagnoses."""
