"""Episode sets in third-party formats: read, checked, placed in scenes, and written again."""
