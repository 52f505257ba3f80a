"""Figures of merit: each measured by one command, gathered on one board."""
