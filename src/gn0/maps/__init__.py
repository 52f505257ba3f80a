"""Occupancy grids, planning and the exact action planner; does not know scenes."""

from gn0.namespace import open_namespace

__getattr__, __dir__, __all__ = open_namespace(__name__, __file__)
