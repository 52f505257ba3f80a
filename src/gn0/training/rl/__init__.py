"""Reinforcement learning: states, answers and walks, what they are worth, and the objective."""
