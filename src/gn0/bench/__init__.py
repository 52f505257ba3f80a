"""Metrics, runner, results and the report."""
