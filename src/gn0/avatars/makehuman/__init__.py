"""Files of MakeHuman: its base mesh hm08, shape targets, rig and clothes."""
