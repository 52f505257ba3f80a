"""Folders of training runs: states that resume exactly, metrics, what a run says."""
