"""Sources of scenes, turned into one Scene and one scene folder."""
