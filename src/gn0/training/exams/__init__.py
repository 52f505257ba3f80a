"""Examinations: policies walk held-out episodes on a device, and every walk is kept."""
