"""Fittings of a supermarket: shelves with goods, coolers, freezers, stands, checkouts, trolleys."""
