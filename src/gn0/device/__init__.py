"""Accelerators: arrays, kernels and launches behind one small protocol; no torch, no compiler."""

from gn0.namespace import open_namespace

__getattr__, __dir__, __all__ = open_namespace(__name__, __file__)
