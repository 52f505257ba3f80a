"""Judges, fuzzers, rogue servers and crash trials: what tests and the board hold GN0 against."""
