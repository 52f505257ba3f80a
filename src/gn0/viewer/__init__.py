"""Pictures and live views of scenes and runs."""
