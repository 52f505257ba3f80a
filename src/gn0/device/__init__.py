"""Accelerators: arrays, kernels and launches behind one small protocol; no torch, no compiler."""
