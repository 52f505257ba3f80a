"""Datasets in the formats that others train and measure with: one module a format."""
