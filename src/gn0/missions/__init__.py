"""Episodes: what an agent is asked to do, where, and the reference path."""
