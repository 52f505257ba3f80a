"""From a scene to missions: targets, starts, paths, filters, goal pictures and texts."""
