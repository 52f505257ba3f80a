"""Sensors as values: one file each; `sensor.py` says what one is, `table.py` finds them by name."""
