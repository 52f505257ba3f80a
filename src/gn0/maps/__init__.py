"""Occupancy grids, planning and the exact action planner; knows no scene."""
