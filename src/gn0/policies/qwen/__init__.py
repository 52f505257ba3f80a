"""Qwen3-VL without torch: shapes, the layout of prompts, weights, and the forward in NumPy."""
