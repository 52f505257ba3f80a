"""Seats: sofas, armchairs, chairs, benches, stools, office chairs, and their cushions."""
