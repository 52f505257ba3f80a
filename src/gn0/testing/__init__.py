"""Public checks that a stranger's plug-in can be run against."""
