"""People who move: who they are in an episode, how they walk, and everybody's next tick."""
