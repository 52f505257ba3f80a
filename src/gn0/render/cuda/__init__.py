"""The renderer for NVIDIA cards: clouds and pictures stay on the device."""
