"""Furnished apartments from a seed: plan, furniture, materials, light."""
