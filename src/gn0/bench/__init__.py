"""Metrics, suites, runner, results and the report."""
