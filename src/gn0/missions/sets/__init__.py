"""Episode sets in other people's formats: read, checked, placed in scenes, and written again."""
